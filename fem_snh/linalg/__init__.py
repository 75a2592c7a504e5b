"""Linear solvers: SSOR-preconditioned conjugate gradients with deflation, and a direct solver.

The SNES of `fem_snh.solver` uses them as its KSP; they know neither meshes nor materials.
"""
