"""Motion in time: inertia, damping, integrators, balance of forces; vibration modes."""
