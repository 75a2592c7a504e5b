"""Tables of scenes and objects of programs: their base, their types, and amplitudes of the load.

Every feature may import this package, as the package imports neither MPI nor PETSc.
"""
