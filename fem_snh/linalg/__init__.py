"""Linear solvers: SSOR-preconditioned conjugate gradients with deflation, and a direct solver."""
