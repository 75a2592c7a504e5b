"""What solves a linear system: block matrix, SSOR-preconditioned CG, deflation, halo exchange."""
