"""Steps in time: inertia, damping, integrators, prescribed motion, energies and momenta."""
