r"""Choose between the iterative and the direct linear solver.

Let N be the number of nodes and s the number of nodes in a section across the longest axis. Sparse
factors cost about as much as :math:`\sqrt{s^3/N}` iterations of conjugate gradients. The number of
iterations is proportional to :math:`(1 - 2 \nu)^{-1/2}`, and to :math:`N/s^{3/2}` where the body is
slender. So both cost the same at a certain value of

.. math:: \frac{s^3}{N^{3/2}} \frac{\sqrt{1 - 2 \nu}}{a} ,

a the mean aspect ratio of the cells if the body can bend, otherwise 1: the number of iterations is
proportional to a, as the stiffness in bending is to its square. The first factor is 0.2 to 0.5 for
bars, 3 for a layer of linear cells, 5 for two layers and :math:`n^{3/2}` for a cube of n cells
along an edge, whatever the size of bar or layer. For a bar that can bend, sparse factors are chosen
at any value: iterations would stop at an unstable equilibrium and not show it
(`fem_snh.solver.stability`). A body that is constrained along its axis, as by a skeleton, needs few
iterations. docs/results/linear_solver.md measures both solvers.

In two dimensions the cost of factors is nearly proportional to N, and so is the cost of the
iterations, as with deflation their number does not grow with N. Iterations cost less where
:math:`\sqrt{1 - 2 \nu}/k` is large, k the degree of the displacement, and the problem has neither
contact nor pressures as unknowns nor other properties that raise the number of iterations.

`AsymmetricSolver` is for Hessians that are not symmetric, of forces without an energy. A follower
pressure on a surface with a free edge, or a residual of UFL, has a derivative that is not
symmetric. Newton's method with its symmetric part converges linearly at best: a plate under such a
pressure takes 20 times as many iterations. Filtered Hessians are symmetric: the SNES's own linear
solver solves with them.
"""

from __future__ import annotations

from functools import cached_property
from math import sqrt
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import expect_singular_matrix
from fem_snh.errors import choose
from fem_snh.linalg.direct_solver import is_factors_of_sum, set_asymmetric_factors
from fem_snh.solver.protocol import Regime, SolvableProblem
from fem_snh.solver.saddle_point import preconditioner_by_blocks

#: Values of ``-snes_linear_solver``; the default first.
CHOICES = ("automatic", "iterative", "direct")
#: Largest s^3/N^(3/2) sqrt(1 - 2 nu) / a for which factors are chosen (measured: python -m
#: benchmarks linear_solvers; docs/results/linear_solver.md).
_MAX = 0.15
#: A body with a smaller s^3/N^(3/2) is a bar.
_MIN_LAYER = 1.5
#: A bar that is constrained along more than this fraction of its axis does not bend, nor does a
#: layer with more than this fraction of its nodes constrained.
_CONSTRAINED = 0.5
#: Mean aspect of the cells from which a body counts as thin: meshes of solid bodies have 1 to 3.
_MIN_ASPECT = 4.0
#: Contrast of the shear moduli from which factors are chosen (measured:
#: python -m benchmarks contrast; docs/results/linear_solver.md).
_CONTRAST = 1e4
#: Nodes of a body above which factors are never chosen; measured up to 33,282.
MAX_NODES = 50_000
#: In two dimensions: the least number of nodes and the least sqrt(1 - 2 nu) / k for which
#: iterations are chosen (measured: python -m benchmarks linear_solvers --bodies
#: membrane,tube,bushing,cylinder,seal), and the largest N/s^2 of a body that does not buckle like a
#: bar: at 3.4 iterations stop at an unstable straight strip
#: (tests/solver/test_linear_choice.py).
_MIN_SECTION_NODES, _MIN_SECTION, _MAX_SLENDERNESS = 1000, 0.12, 2.0


class LinearChoice(NamedTuple):
    """The choice between a direct and an iterative linear solver.

    Attributes
    ----------
    direct : bool
        Whether the solver has sparse factors.
    reason : str
        Why the solver was chosen; empty if the user chose it.
    """

    direct: bool
    reason: str = ""


def choose_linear_solver(problem: SolvableProblem, wanted: str = CHOICES[0]) -> LinearChoice:
    """Return the linear solver of a problem. Collective.

    Parameters
    ----------
    problem : SolvableProblem
    wanted : str
        One of `CHOICES`; "automatic" chooses by `Regime`.

    Raises
    ------
    BadInput
        For an unknown value.
    """
    regime = problem.regime
    if choose("snes_linear_solver", wanted, CHOICES) != CHOICES[0]:
        return LinearChoice(wanted == "direct")
    if not problem.is_assembled:
        reason = "a load adds matrices of rank one, which are applied without being assembled"
        few = regime.dimension == 2 or problem.saddle_point is not None
        if few and regime.nodes <= MAX_NODES:
            return LinearChoice(True, f"{reason}: sparse factors of the rest")
        return LinearChoice(False, reason)
    if regime.dimension == 2:
        return _choose_for_section(regime, problem.saddle_point is not None)
    direct = not regime.inertia and regime.nodes <= MAX_NODES
    if direct and regime.contrast >= _CONTRAST:
        reason = f"contrast of the moduli = {regime.contrast:.2g} >= {_CONTRAST:g}"
        return LinearChoice(True, f"{reason}: iterations would be many")
    if problem.saddle_point is not None:
        return LinearChoice(False, "an unknown pressure: few iterations for every nu and mesh")
    if regime.inertia:
        return LinearChoice(False, "in time: iterations, with exact rigid motions")
    nodes = regime.nodes
    if nodes > MAX_NODES:
        return LinearChoice(False, f"{nodes} nodes > {MAX_NODES}: factors would need much memory")
    value, name = regime.section_nodes**3 / nodes**1.5, "s^3/N^1.5"
    if value < _MIN_LAYER:
        bar = f"{name} = {value:.2g} < {_MIN_LAYER:g}: a bar"
        if regime.supported <= _CONSTRAINED:
            return LinearChoice(True, f"{bar}, which may buckle: factors tell stable from unstable")
        return LinearChoice(False, f"{bar} that is constrained along its axis: few iterations")
    value *= sqrt(max(0.0, 1 - 2 * regime.poisson_ratio))
    name += " sqrt(1 - 2 nu)"
    if regime.constrained <= _CONSTRAINED and regime.cell_aspect >= _MIN_ASPECT:
        value, name = value / regime.cell_aspect, f"{name} / a"
    measured = f"{name} = {value:.2g} {'<=' if value <= _MAX else '>'} {_MAX:g}"
    if value <= _MAX:
        return LinearChoice(True, f"{measured}: factors cost less than many iterations")
    return LinearChoice(False, f"{measured}: iterations cost less time and memory than factors")


def _choose_for_section(regime: Regime, saddle_point: bool) -> LinearChoice:
    """Return the linear solver of a problem on a mesh of two dimensions."""
    slenderness = regime.nodes / regime.section_nodes**2
    value, name = sqrt(max(0.0, 1 - 2 * regime.poisson_ratio)), "sqrt(1 - 2 nu)"
    if regime.degree > 1:
        value, name = value / regime.degree, f"{name} / {regime.degree}"
    for_factors = {
        "an unknown pressure": saddle_point,
        "contact": regime.contact,
        f"contrast of the moduli = {regime.contrast:.2g}": regime.contrast >= _CONTRAST,
        f"mean aspect of the cells = {regime.cell_aspect:.2g}": regime.cell_aspect >= _MIN_ASPECT,
        f"N/s^2 = {slenderness:.2g} > {_MAX_SLENDERNESS:g}, which may buckle": (
            slenderness > _MAX_SLENDERNESS and regime.supported <= _CONSTRAINED
        ),
        f"{regime.nodes} nodes < {_MIN_SECTION_NODES}": regime.nodes < _MIN_SECTION_NODES,
        f"{name} = {value:.2g} < {_MIN_SECTION:g}": value < _MIN_SECTION,
    }
    for reason, holds in for_factors.items():
        if holds:
            return LinearChoice(True, f"a mesh of 2 dimensions, {reason}: factors cost little")
    measured = f"{name} = {value:.2g} >= {_MIN_SECTION:g}"
    return LinearChoice(False, f"a mesh of 2 dimensions, {measured}: few iterations")


#: Types of linear solvers that need a symmetric matrix; "python" is `EisenstatCG`.
_SYMMETRIC = frozenset("cg pipecg groppcg fcg minres symmlq nash stcg gltr python".split())
#: Largest number of iterations of GMRES, without a restart; then the solution is used as it is.
#: A strip of 3,157 nodes takes 60 to 90 iterations to a relative residual of 1e-3.
_MAX_IT = 200


class AsymmetricSolver:
    """The linear solver of a problem whose exact Hessian may not be symmetric.

    It has sparse factors L U, as the preconditioner of GMRES if the operator has matrices of rank
    one. It is GMRES with incomplete factors of each rank's rows if the user chose iterations, or
    where inertia makes the matrix well conditioned or factors would need much memory. ``own`` is
    kept if it needs no symmetric matrix, or preconditions by blocks.

    Parameters
    ----------
    problem : SolvableProblem
        The problem.
    own : PETSc.KSP
        The linear solver of symmetric Hessians, set up by the options.
    choice : LinearChoice
        How ``own`` was chosen.
    """

    def __init__(self, problem: SolvableProblem, own: PETSc.KSP, choice: LinearChoice) -> None:
        self._problem, self._own, self._choice = problem, own, choice

    @property
    def needed(self) -> bool:
        """Whether the Hessian that was assembled last is not symmetric."""
        return self._problem.asymmetric

    @cached_property
    def ksp(self) -> PETSc.KSP:
        """The solver: ``own``, or a KSP that the first access creates. Collective."""
        own, problem, regime = self._own, self._problem, self._problem.regime
        pc = own.getPC()
        symmetric = own.getType() in _SYMMETRIC or pc.getType() == PETSc.PC.Type.CHOLESKY
        symmetric |= is_factors_of_sum(pc)
        if preconditioner_by_blocks(pc) or not symmetric:
            return own
        ksp = PETSc.KSP().create(own.comm)
        rtol, atol = own.getTolerances()[:2]
        set_asymmetric_factors(ksp)
        if problem.pressure_level_is_free:
            expect_singular_matrix(ksp)
        chosen = not self._choice.reason  # by the user
        large = regime.dimension == 3 and (regime.inertia or regime.nodes > MAX_NODES)
        iterative = not self._choice.direct and (chosen or large)
        if iterative:
            ksp.getPC().setType(PETSc.PC.Type.BJACOBI)
        if iterative or not problem.is_assembled:  # the factors lack matrices of rank one
            ksp.setType(PETSc.KSP.Type.GMRES)
            ksp.setGMRESRestart(_MAX_IT)
            ksp.setTolerances(rtol=rtol, atol=atol, max_it=_MAX_IT)
        return ksp

    def destroy(self) -> None:
        """Destroy the solver unless it is ``own``. Collective."""
        if "ksp" in self.__dict__ and self.ksp != self._own:
            self.ksp.destroy()
