"""Unknown pressures: saddle-point problems and their approximate Schur complements."""
