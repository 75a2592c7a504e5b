"""Time steps: inertia, damping, integrators, prescribed motion, energies and momenta."""
