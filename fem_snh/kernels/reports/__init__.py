"""Characterise a material: stability, admissible region, stress curves.

    >>> m = fem_snh.material("stable_neo_hookean", nu=0.49)
    >>> print(m.report())
    >>> m.report().plot("stable_neo_hookean.png")

`curves` computes stress against stretch and the region of a positive tangent. `stability` evaluates
the four stability properties of Smith et al. 2018. `report` combines both and compares materials.
Only reflection stability uses the symbolic expression, because the kernels fix one convention for
the sign of the stretches.
"""
