r"""The differences of goals between a run and its lifted problem, which Newton iterations find.

The run's state is the first guess, and the solver is that of the run, so that a few iterations
suffice. Where each reduces the residual to :math:`\rho` times its size, all further ones change a
vector by a multiple of :math:`\rho / (1 - \rho)` times its last change.

How much of the error the lifted solution leaves follows from the decay of its own degrees. The
error of an element of degree p on a given mesh decreases as :math:`C p^{-\beta}` where the solution
is singular (Babuska & Suri 1987), and faster where it is smooth. A lifted solution of degree 3 has
the parts of degree 2 and 3 in each cell, of squares

.. math:: a_k = \int_K \lvert \nabla (I_k u_+ - I_{k-1} u_+) \rvert^2 \, \mathrm{d}V,

with the nodal interpolations I_k of degree k. Their ratio gives the cell's :math:`\beta`, and so
the sum of all further parts. The estimate is multiplied by the sum of the parts from degree 3 on,
over all cells, divided by that of degree 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import log
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx, solver
from fem_snh._petsc import negative_pivots
from fem_snh.accuracy.effectivity import OF_VECTOR
from fem_snh.accuracy.goal_errors import Estimate, NoEstimate
from fem_snh.arrays import Array
from fem_snh.assembly.unknowns import local_values
from fem_snh.errors import BadInput
from fem_snh.linalg.direct_solver import is_direct
from fem_snh.mesh.mesh import point_volumes
from fem_snh.problem.duals import HessianSolver, assemble_hessian
from fem_snh.problem.free_motions import Supports
from fem_snh.problem.goals import Goal, bind_all, slices_of
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import is_at_rest
from fem_snh.solver.stability import are_factors_cheap, has_negative_curvature, is_definite

#: Prefix of its solver's options: those of the run are for another problem.
PREFIX = f"{solver.PREFIX}lifted_"
#: Relative tolerance of linear solves. 1e-2 leaves half of the differences of a slender body after
#: an iteration, and up to 80 % of the indicators of a force, whose dual solution is about a
#: translation of the body: their products with the residual cancel. 1e-3 leaves 3 %.
_RTOL = 1e-3
#: Further iterations change a difference by so many times what the reduction of the residual says,
#: whose norm weighs slow modes less (error_estimates of cook, twist and plane: with 3, settled
#: differences change by at most 2 %).
_CONTRACTION = 3.0
#: Part of a difference, or of the error that matters, that may be unsettled: a small part of the
#: half that its bound is at least.
SETTLED = 0.02
#: Newton iterations in all: a state that needs more is far from the run's.
_MAX_IT = 30
#: What negative eigenvalues say of the run's state.
_LEAVES = "and on finer cells the body may leave it"


class Lift:
    """Solves the lifted problem from the state of the run. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    lifted : Problem
        The same with the lifted element, from `fem_snh.accuracy.lift.create_in`.
    update : tuple, optional
        Arguments of ``snes.setUpdate``.

    Attributes
    ----------
    newton, linear : int
        Newton and linear iterations so far.
    start, start_gradient : PETSc.Vec
        The run's state in the lifted problem, and the gradient of the energy there.

    Raises
    ------
    NoEstimate
        If the lifted problem cannot start from this state.
    """

    def __init__(self, problem: Problem, lifted: Problem, update: Any = None) -> None:
        self.problem, self.lifted = problem, lifted
        self.newton = self.linear = 0
        self.start, self.start_gradient = lifted.x.copy(), lifted.gradient_at(lifted.x)
        try:
            lifted.history.begin_step(lifted.split(lifted.x)[0])
        except BadInput as error:  # a barrier, as finer triangles of the surface may intersect
            raise NoEstimate(
                f"the run's state is not admissible in {lifted.element.name}: {error}"
            ) from None
        # Each solve is one Newton iteration, which does not end at an equilibrium.
        self._snes = solver.create(lifted, prefix=PREFIX, examine_stability=False)
        if update:
            self._snes.setUpdate(*update)
        #: The Hessian of the last Newton iteration.
        self._last_filter = ""
        #: Whether the solver has the exact Hessian, with its preconditioner.
        self._is_assembled = False

    def differences(
        self, goals: Sequence[Goal], estimate: Estimate, asked: float
    ) -> tuple[Array, Array]:
        """Return the goals in the lifted problem less those of the run, (goals,).

        And by how much further iterations would change them, about.

        Parameters
        ----------
        goals : sequence of Goal
            The goals.
        estimate : Estimate
            Has their values in the run, and what their errors are relative to.
        asked : float
            The relative error that matters.

        Raises
        ------
        NoEstimate
            If no stable equilibrium is found.
        """
        evaluate, small, settled = bind_all(goals, self.lifted), False, False
        values, scales = estimate.values(goals), estimate.scales(goals)
        found = np.zeros(len(values))
        while not settled:
            outcome = self._iterate()
            before, found = found, evaluate() - values
            if not np.isfinite(found).all():
                name = self.lifted.element.name
                raise NoEstimate(f"a goal is not finite in the state of {name}")
            if not outcome.newton:
                forces = self.problem.largest_force(self.problem.x)
                resolved = forces and not is_at_rest(self.problem)
                part = outcome.residual / forces if resolved else 0.0  # of a solution, about
                unsettled = part * np.where(np.isfinite(scales), scales, 0.0)
                if self.newton == 0:  # the run's state is a solution
                    unsettled = np.maximum(np.abs(found), unsettled)
                break
            rate = max(outcome.residual / outcome.history[0].residual, _RTOL)
            further = _CONTRACTION * rate / (1 - rate)
            unsettled = further * _sizes(goals, found - before)
            limits = SETTLED * np.maximum(np.abs(found), asked * scales)
            # A filter at the interpolated state says nothing yet of the one that is sought.
            small, was_small = bool((unsettled <= limits).all()), small
            settled = small and (self._is_stable or was_small)
        if not self._is_stable:
            raise self._unstable("negative curvature")
        return found, unsettled

    def _iterate(self) -> solver.StepOutcome:
        """Make a Newton iteration, or several until the residual decreases. Collective.

        It makes no iteration where the residual is zero to all digits.

        Raises
        ------
        NoEstimate
            If the solver does not converge.
        """
        self._snes.setTolerances(max_it=max(_MAX_IT - self.newton, 0))
        context = self._snes.getPythonContext()
        context.reduction = 1 - 1e-3  # any decrease that is more than rounding
        context.options["snes_forcing_max"] = _RTOL
        outcome = solver.StepOutcome()
        solver.solve_until_settled(self.lifted, self._snes, outcome)
        self.newton += outcome.newton
        self.linear += outcome.linear
        if outcome.history:
            self._last_filter = outcome.history[-1].filter
            self._is_assembled = self._last_filter in ("exact", "none needed")
        if not outcome.converged:
            unstable = "" if self._is_stable else f": the Hessian has negative curvature, {_LEAVES}"
            raise NoEstimate(
                f"no equilibrium of {self.lifted.element.name} was found near the run's "
                f"({outcome.reason} after {self.newton} Newton iterations){unstable}"
            )
        return outcome

    @property
    def _is_stable(self) -> bool:
        """Whether the last Newton step needed no filter; a pressure may hide instability."""
        return self._last_filter not in ("clamp", "abs")

    def dual_solver(self) -> HessianSolver:
        """Return the solver with the Hessian at the solution. Collective.

        On fine meshes, where errors are small, that of the last Newton iteration serves: sums of
        indicators change by 1 to 2 %. Where the preconditioner finds the
        Hessian indefinite, the filtered one replaces it. The solutions are NaN if no solver
        converges.
        """
        serves = self._is_assembled and not are_factors_cheap(self.lifted)
        return HessianSolver(self.lifted, self._snes.getKSP(), _RTOL, assembled=serves)

    def may_be_unstable(self, asked: bool) -> bool:
        """Find out whether the exact Hessian has negative eigenvalues. Collective.

        A perfect column is straight in both elements, and the better one buckles before the stiffer
        one does. A solver with sparse factors has often counted the eigenvalues. Otherwise
        iterations tell that there are none (`fem_snh.solver.stability`); where they do not, they
        are counted if that is cheap, or it is ``asked`` for.

        Returns
        -------
        bool
            Whether that is unknown, as iterations do not tell.

        Raises
        ------
        NoEstimate
            If the equilibrium is unstable: on a finer mesh the body may leave it.
        """
        lifted, ksp = self.lifted, self._snes.getKSP()
        if not solver.is_conservative(lifted):
            return False
        stability = solver.EquilibriumStability(lifted)
        if is_direct(ksp):
            if self._is_assembled and negative_pivots(ksp.getPC()) == stability.expected:
                return False
        elif not asked:
            definite = None
            if not lifted.rigid:  # rotations of rigid parts are other unknowns
                if not self._is_assembled:
                    assemble_hessian(lifted, ksp, "exact")
                definite, self._is_assembled = is_definite(lifted, ksp), True
            if definite:
                return False
            if not are_factors_cheap(lifted):
                if lifted.rigid or not lifted.is_assembled:
                    return True
                # An unknown pressure makes up for negative eigenvalues of the displacement's part.
                negative = definite is False
                if lifted.saddle_point:
                    self._is_assembled, negative = False, has_negative_curvature(lifted, ksp)
                if negative:
                    raise self._unstable("negative eigenvalues")
                return True
        self._is_assembled, count = False, stability.negative_eigenvalues(lifted.x)
        # Free rotations of rigid parts, whose unknowns are others, have eigenvalues of the size of
        # the residual, which a few Newton iterations leave.
        rigid = len(Supports(lifted).free_motions()) if count > 0 and lifted.rigid else 0
        if count > rigid:
            raise self._unstable(f"{count} negative eigenvalue{'s' if count > 1 else ''}")
        return False

    def _unstable(self, what: str) -> NoEstimate:
        """Return that there is no estimate, as what the Hessian has shows an instability."""
        return NoEstimate(
            f"the equilibrium of {self.lifted.element.name} near the run's is unstable: its "
            f"Hessian has {what}, {_LEAVES}"
        )

    def close(self) -> None:
        """Destroy the solver."""
        solver.destroy(self._snes)


def _sizes(goals: Sequence[Goal], values: Array) -> Array:
    """Return the sizes of scalars; of a component at least a fifth of the largest in its vector."""
    sizes = np.abs(values)
    for components in slices_of(goals):
        least = OF_VECTOR * sizes[components].max()
        sizes[components] = np.maximum(sizes[components], least)
    return sizes


#: Exponents between which the decay of a cell is sought. 2 is that of a crack in linear elasticity,
#: with the square root of the distance. At the edge of the clamped face of a nearly incompressible
#: body strains are finite, and cells have exponents of 0.8 to 1.2: with 1.5 the estimates are right
#: there (docs/theory/error.md). At 12 a further degree leaves less than a hundredth.
_EXPONENTS = np.linspace(1.5, 12.0, 211)


def saturation(lifted: Problem, u: PETSc.Vec) -> float:
    """Return the factor of estimates by a lifted displacement, at least 1. Collective.

    ``u`` is a ghosted vector: the solution, or a mode of vibration.
    A lifted solution of degree 2 has one part alone, and no ratio: the factor is 1.
    """
    if lifted.element.degree < 3:
        return 1.0
    second, third = _parts(lifted, u).T
    ratio = np.divide(third, second, out=np.zeros_like(third), where=second > 0)
    further = np.interp(ratio, *_table())
    sums = lifted.comm.allreduce(np.array([third.sum(), (third * further).sum()]))
    return float(1 + sums[1] / sums[0]) if sums[0] > 0 else 1.0


def _table() -> tuple[Array, Array]:
    """Return ratios a_3/a_2, increasing, and the sums of a_k, k > 3, over a_3."""
    powers = {p: np.exp(-log(p) * _EXPONENTS) for p in (2, 3)}
    ratio = (powers[2] - powers[3]) / (1 - powers[2])
    further = powers[3] / (powers[2] - powers[3])
    return ratio[::-1], further[::-1]


def _parts(lifted: Problem, vector: PETSc.Vec) -> Array:
    """Return a_2 and a_3 of each cell of this rank, (cells, 2)."""
    domain, element, kinematics = lifted.domain, lifted.element, lifted.kinematics
    cell, degree = element.cell, element.degree
    points, _ = _dolfinx.quadrature(cell, element.quadrature)
    volumes = point_volumes(domain, element.quadrature, kinematics.revolved)
    X = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)][..., : kinematics.dim]
    tangents = _dolfinx.tabulate_geometry(domain, points)
    inverse = np.linalg.inv(np.einsum("cgi,pgj->cpij", X, tangents, optimize=True))
    u = local_values(vector).reshape(-1, kinematics.components)[_dolfinx.node_dofs(lifted.V)]
    gradients = []  # of I_1 u to I_3 u, (cells, points, components, dim)
    for k in (1, 2, 3):
        nodes = _dolfinx.reference_nodes(cell, k)
        values = _dolfinx.tabulate_element(cell, degree, nodes, 0)[0] @ u
        basis = _dolfinx.tabulate_element(cell, k, points, 1)[1:]
        gradients.append(np.einsum("jpk,cki->cpij", basis, values, optimize=True) @ inverse)
    squares = [((new - old) ** 2).sum(axis=(2, 3)) for old, new in pairwise(gradients)]
    return np.stack([(volumes * square).sum(axis=1) for square in squares], axis=1)
