"""What an energy is like, asked before an hour is spent on it.

    >>> m = fem_snh.material("stable_neo_hookean", nu=0.49)
    >>> print(m.report())
    >>> m.report().plot("stable_neo_hookean.png")

`curves` (stress against stretch), `drucker` (where the tangent is positive), `stability` (the four
of Smith et al. 2018, measured), `minima` (every shape it may rest in), `collapse` (J -> 0 and
beyond), `table` (all materials). Everything is measured on the kernels that the assembly uses;
only blindness to reflections is asked of the expression, as the kernels have one convention.
"""
