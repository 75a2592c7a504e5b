"""Named choices that scenes, kernels and solver share, and their defaults."""

from __future__ import annotations

from fem_snh.errors import bad_value, note_rename

#: Eigenvalue filters of a Hessian at a quadrature point, in the order of material_point.h.
FILTERS = ("exact", "clamp", "abs")

#: Hessians of Newton's method: one filter throughout, or ``adaptive``: exact while the linear
#: solver finds it positive definite, filtered when it does not.
HESSIANS = (*FILTERS, "adaptive")

#: What makes Newton's method converge from a distant start (Nocedal & Wright 2006, chapters 3, 4).
GLOBALIZATIONS = ("linesearch", "trust_region")

#: Eigensolvers of the Hessian's 3x3 scaling block; the default first (docs/results/eigensolver.md).
EIGENSOLVERS = ("cubic", "jacobi")

#: What evaluates the elastic energy and its residual: the compiled kernels, or forms of UFL that
#: FFCx compiles. The Hessian is always the kernels', which filter it.
ASSEMBLIES = ("kernels", "ufl")

#: First guesses of a load step.
PREDICTORS = ("none", "extrapolate", "tangent")

#: The defaults of scenes, of the command line and of `fem_snh.solver.create` alike.
DEFAULT_HESSIAN = "adaptive"
DEFAULT_PREDICTOR = "extrapolate"
DEFAULT_EIGENSOLVER = EIGENSOLVERS[0]
DEFAULT_ASSEMBLY = ASSEMBLIES[0]

#: The default globalization of each kind of problem, if no Hessian is named either. Without an
#: energy to minimise there is nothing that a trust region could reduce.
DEFAULT_GLOBALIZATIONS = {
    "minimisation problem": "trust_region",
    "saddle-point problem": "linesearch",  # Taylor-Hood elements
    "forces without an energy": "linesearch",
}

#: The default globalization if a Hessian is named: the textbook's method with that Hessian, such as
#: that of Smith et al. 2018 with ``clamp``.
GLOBALIZATION_OF_NAMED_HESSIAN = "linesearch"

#: L-BFGS iterations after a Newton step, at most: with a line search, and in a trust region, where
#: 640 leave a half to a sixth of the Newton iterations that 40 do (measured:
#: python -m benchmarks negative_curvature --lbfgs 40,640; docs/results/figures.md).
DEFAULT_LBFGS_MAX_IT = {"linesearch": 0, "trust_region": 640}

#: ``hessian = "trust"``, the name of a choice of both until 0.1.0.
_ALIAS, _MEANING = "trust", ("adaptive", "trust_region")


def replace_alias(
    hessian: str | None, globalization: str | None, warn: bool = True
) -> tuple[str | None, str | None]:
    """Return the two choices with ``hessian = 'trust'`` replaced by what it stands for.

    Parameters
    ----------
    hessian, globalization : str or None
        As given by a user; None where nothing was said.
    warn : bool
        Issue a note (`RenamedKey`) if the alias is used: to be asked on one rank only.

    Raises
    ------
    BadInput
        If the alias contradicts ``globalization``.
    """
    if hessian != _ALIAS:
        return hessian, globalization
    if globalization not in (None, _MEANING[1]):
        accepted = f"'{_MEANING[1]}', which hessian = 'trust' stands for"
        raise bad_value("globalization", globalization, accepted)
    if warn:
        note_rename("hessian = trust", "hessian = {}, globalization = {}".format(*_MEANING))
    return _MEANING
