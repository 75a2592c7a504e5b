"""Tables of scenes and objects of programs: their base, their types, and amplitudes of the load.

Any feature may import it: it needs neither MPI nor PETSc.
"""
