"""Words that scenes, kernels and solver share, spelled the same everywhere."""

#: What is done to a Hessian at a quadrature point, in the order of material_point.h.
FILTERS = ("exact", "clamp", "abs")

#: Which of them Newton's method asks for before a line search; ``adaptive`` decides by itself.
SEARCHED = (*FILTERS, "adaptive")
#: ``trust``: the exact one, within a trust region.
HESSIANS = (*SEARCHED, "trust")

#: Of the 3x3 scaling block; the default first (docs/results/eigensolver.md).
EIGENSOLVERS = ("cubic", "jacobi")

#: Where a load step starts.
PREDICTORS = ("none", "extrapolate", "tangent")
