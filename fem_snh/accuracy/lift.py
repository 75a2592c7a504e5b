"""The lifted problem: the same one in the element of the next degree on the same cells.

A body's error of discretisation is estimated as the difference between two equilibria: the run's,
and that of an element whose own error is smaller by a power of the cell size. The run's own state
is the first guess, and the solver is that of the run, so that a few Newton iterations suffice
(docs/theory/error.md).

The lifted element has a continuous pressure (Taylor-Hood), so that it does not lock either: Q1 and
Q1P0 are lifted to Q2Q1, P1 to P2P1, elements of degree 2 to P3P2 and Q3Q2. Others serve where that
is not needed, or not possible (docs/theory/error.md).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx, solver
from fem_snh._petsc import negative_pivots
from fem_snh.accuracy.goal_errors import NoEstimate, NoEstimateOnAnyMesh
from fem_snh.assembly.elements import ELEMENTS, Element, in_kinematics
from fem_snh.assembly.unknowns import summed_over_cells
from fem_snh.errors import BadInput
from fem_snh.linalg.direct_solver import is_direct
from fem_snh.problem.duals import HessianSolver, assemble_hessian
from fem_snh.problem.free_motions import Supports
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import may_lock
from fem_snh.solver.stability import has_negative_curvature, is_definite

#: Prefix of its solver's options: those of the run are for another problem.
PREFIX = f"{solver.PREFIX}lifted_"
#: A solve is one Newton iteration, and more of them only where one does not reduce the residual.
_REDUCED = 0.999
#: Relative tolerances of the linear solves of the first Newton iteration, which is far from
#: quadratic convergence, and of the others.
_LINEAR = 0.05, 1e-2
#: Relative tolerances of dual solutions with an unknown pressure, in the residual's norm, and of
#: others, in the norm of the preconditioner. That of a force is about a translation of the body,
#: whose products with the residual cancel: in that norm 3e-3 leaves up to 80 % of an indicator's
#: size, 3e-4 less than 3 % (docs/results/error.md).
_DUAL, _DUAL_OF_DISPLACEMENT = 3e-3, 3e-4
#: Length of the last Newton step over the way from the run's state, up to which its Hessian serves
#: dual solutions as well as one more. So it does on any mesh of more than `_MAX_FACTORED` nodes,
#: where errors are small: indicators change by 0.5 to 1 % of their sum (docs/results/error.md).
_CLOSE = 0.005
#: The run's pressure is no first guess if its residual is so many times that of zero pressure. For
#: locked elements the ratio is up to 2 (Cook's membrane, degree 1, nu = 0.4999).
_WORSE = 4.0
#: Nodes up to which factors of one Hessian cost at most a third of the estimate (twist, 4 cells of
#: Q2 across: 0.3 of 1 s with 2,197 nodes; 6 cells: 1.9 of 3.1 s with 6,859).
_MAX_FACTORED = 5_000
#: The energy density is convex if the eigenvalues of its Hessian are above minus this part of E:
#: they are about as large as the compressive strain, and a plate of 100 times its thickness buckles
#: at 4e-4.
_CONVEX = 1e-4
#: Newton iterations in all: a state that needs more is far from the run's.
_MAX_IT = 30
#: What the last Hessian of iterations that fail says of the run's state.
_NEGATIVE = "the Hessian has negative curvature there, and on finer cells the body may leave it"


def create_lifted(problem: Problem, make: Callable[[Element], Problem]) -> Problem:
    """Return the lifted problem at the problem's load. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    make : callable
        Returns the same problem on the same mesh with another element.

    Raises
    ------
    NoEstimate
        For materials that no lifted element supports.
    """
    reason = ""
    for element in lifted_elements(problem):
        try:
            return create_in(element, problem, make)
        except BadInput as error:  # a material without a volume term of its own
            reason = reason or str(error)
    raise NoEstimateOnAnyMesh(f"no element of degree {problem.element.degree + 1} fits: {reason}")


def create_in(element: Element, problem: Problem, make: Callable[[Element], Problem]) -> Problem:
    """Return the problem with another element, at its load and displacement. Collective."""
    other = make(element)
    for term, base in zip(other.terms, problem.terms, strict=True):
        if isinstance(base, type(term)):
            term.share_lengths(base)
    other.interpolate(problem)
    return other


class Lift:
    """Solves the lifted problem from the state of the run. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    lifted : Problem
        The same with the lifted element, from `create_in`.

    Attributes
    ----------
    newton : int
        Newton iterations so far.
    reduction, last_reduction : float
        What is left of the first residual, and what the last solve left of its own.
    start, start_gradient : PETSc.Vec
        The run's state in the lifted problem, and the gradient of the energy there.

    Raises
    ------
    NoEstimate
        If the lifted problem cannot start from this state.
    """

    def __init__(self, problem: Problem, lifted: Problem) -> None:
        self.problem, self.lifted = problem, lifted
        self.newton = self._linear = 0
        self._solvers: list[HessianSolver] = []
        if lifted.saddle_point is not None:
            self._guess_pressure()
        self.start, self.start_gradient = lifted.x.copy(), lifted.x.duplicate()
        lifted.gradient(self.start, self.start_gradient)
        try:
            lifted.history.begin_step(lifted.split(lifted.x)[0])
        except BadInput as error:  # a barrier, as finer triangles of the surface may intersect
            raise NoEstimate(
                f"the run's state is not admissible in {lifted.element.name}: {error}"
            ) from None
        # Each solve is one Newton iteration, which does not end at an equilibrium.
        self._snes = solver.create(lifted, prefix=PREFIX, examine_stability=False)
        self._outcome, self._last_filter = solver.StepOutcome(), ""
        self.reduction = self.last_reduction = 1.0
        self._last_change = 0.0  # of all unknowns, in the last Newton iteration

    def solve(self) -> None:
        """Solve until the residual is below 0.999 of the present one: usually one iteration.

        Collective.

        Raises
        ------
        NoEstimate
            If the solver does not converge.
        """
        left = _MAX_IT - self.newton
        self._snes.setTolerances(max_it=max(left, 0))
        context = self._snes.getPythonContext()
        context.reduction = _REDUCED
        context.options["snes_forcing_max"] = _LINEAR[self.newton > 0]
        self._outcome = outcome = solver.StepOutcome()
        before = self.lifted.x.copy()
        solver.solve_until_settled(self.lifted, self._snes, outcome)
        self._last_change = (self.lifted.x - before).norm()
        self.newton += outcome.newton
        self._linear += outcome.linear
        if outcome.history:
            self._last_filter = outcome.history[-1].filter
            self.last_reduction = outcome.residual / outcome.history[0].residual
            self.reduction *= self.last_reduction
        if not outcome.converged:
            unstable = "" if self.stable else f": {_NEGATIVE}"
            raise NoEstimate(
                f"no equilibrium of {self.lifted.element.name} was found near the run's "
                f"({outcome.reason} after {self.newton} Newton iterations){unstable}"
            )

    def linear_solves(
        self,
        assemble: bool = False,
        tolerance: float | None = None,
        filters: Sequence[str] = ("exact", "clamp"),
    ) -> HessianSolver:
        """Return the solver with the Hessian at the present state. Collective.

        That of the last Newton iteration serves if its step was short or the mesh is fine, unless
        ``assemble``. Where the preconditioner finds the Hessian indefinite, the filtered one
        replaces it. The solutions are NaN if no solver converges.
        """
        is_close = self._last_change <= _CLOSE * (self.lifted.x - self.start).norm()
        serves = is_close or self.lifted.regime.nodes > _MAX_FACTORED
        assembled = not assemble and self._is_exact and serves
        tolerance = tolerance or (_DUAL if self.lifted.saddle_point else _DUAL_OF_DISPLACEMENT)
        duals = HessianSolver(self.lifted, self._snes.getKSP(), tolerance, filters, assembled)
        self._solvers.append(duals)
        return duals

    @property
    def linear(self) -> int:
        """The linear iterations so far, those of dual solutions among them."""
        return self._linear + sum(duals.iterations for duals in self._solvers)

    def forget_hessian(self) -> None:
        """Let `linear_solves` assemble the Hessian, as another solver has changed the matrix."""
        self._last_filter = ""

    @property
    def _is_exact(self) -> bool:
        """Whether the matrix is the exact Hessian of the last Newton iteration."""
        return self._last_filter in ("exact", "none needed")

    @property
    def at_end(self) -> bool:
        """Whether the last solve found that its start was a solution to all digits."""
        return self._outcome.newton == 0

    @property
    def residual(self) -> float:
        """The norm of the residual that the last solve left [N]."""
        return self._outcome.residual

    @property
    def stable(self) -> bool:
        """Whether the last Newton step needed no filter; a pressure may hide instability."""
        return self._last_filter not in ("clamp", "abs")

    def check_stability(self, asked: bool) -> bool:
        """Find out whether the exact Hessian has negative eigenvalues. Collective.

        A perfect column is straight in both elements, and the better one buckles before the stiffer
        one does. A solver with sparse factors has often counted the eigenvalues. Otherwise
        iterations tell that there are none (`fem_snh.solver.stability`); where they do not, they
        are counted if that is cheap.

        Parameters
        ----------
        asked : bool
            Whether they are counted whatever it costs.

        Returns
        -------
        bool
            Whether the equilibrium may be unstable: iterations do not tell, and at some points the
            energy density is not convex. Where it is convex at all points, the body is stable.

        Raises
        ------
        NoEstimate
            If the equilibrium is unstable: on a finer mesh the body may leave it.
        """
        if not solver.is_conservative(self.lifted):
            return False
        stability, ksp = solver.EquilibriumStability(self.lifted), self._snes.getKSP()
        if is_direct(ksp):
            if self._is_exact and negative_pivots(ksp.getPC()) == stability.expected:
                return False
        elif not asked:
            definite = self._is_definite()
            if definite:
                return False
            if self.lifted.regime.nodes > _MAX_FACTORED:
                return self._may_be_unstable(definite)
        count = stability.negative_eigenvalues(self.lifted.x)
        # Free rotations of rigid parts, whose unknowns are others, have eigenvalues of the size of
        # the residual, which a few Newton iterations leave.
        rigid = len(Supports(self.lifted).free_motions()) if count > 0 and self.lifted.rigid else 0
        if count > rigid:
            raise self.unstable(f"{count} negative eigenvalue{'s' if count > 1 else ''}")
        return False

    def unstable(self, what: str) -> NoEstimate:
        """Return that there is no estimate, as what the Hessian has shows an instability."""
        return NoEstimate(
            f"the equilibrium of {self.lifted.element.name} near the run's is unstable: its "
            f"Hessian has {what}, and on finer cells the body may leave it"
        )

    def _is_definite(self) -> bool | None:
        """Return whether the exact Hessian is definite; None if iterations do not tell."""
        lifted, ksp = self.lifted, self._snes.getKSP()
        lowest = lifted.cell_fields(lifted.x)["min_eigenvalue"]
        is_convex = bool((lowest >= -_CONVEX * lifted.modulus).all())
        if lifted.comm.allreduce(is_convex, op=MPI.LAND):
            return True
        if lifted.rigid:  # rotations of its parts that nothing constrains are other unknowns
            return None
        if not self._is_exact:
            assemble_hessian(lifted, ksp, "exact")
        return is_definite(lifted, ksp)

    def _may_be_unstable(self, definite: bool | None) -> bool:
        """Return whether iterations leave the stability unknown; raise NoEstimate if unstable."""
        lifted, ksp = self.lifted, self._snes.getKSP()
        if lifted.rigid or lifted.operator != lifted.A:
            return True
        # An unknown pressure makes up for negative eigenvalues of the displacement's part.
        sure = lifted.saddle_point is None and definite is False
        if sure or (lifted.saddle_point and has_negative_curvature(lifted, ksp)):
            raise self.unstable("negative eigenvalues")
        return True

    def destroy(self) -> None:
        """Destroy the solver."""
        solver.destroy(self._snes)

    def _guess_pressure(self) -> None:
        """Set the pressure to the run's, or to zero if that residual is much smaller.

        The residual at the run's pressure is the better one to locate the error with: at pressure
        zero that of the volume is as large as the pressure.
        """
        lifted, saddle_point = self.lifted, self.lifted.saddle_point
        assert saddle_point is not None
        without, residual = lifted.x.copy(), lifted.x.duplicate()
        lifted.residual(lifted.x, residual)
        norm = residual.norm()
        pressure = self._pressure()
        dofs = saddle_point.pressure_dofs(lifted.x)
        dofs[:] = pressure[: len(dofs)] / saddle_point.unit
        lifted.residual(lifted.x, residual)
        if not residual.norm() < _WORSE * norm:
            without.copy(lifted.x)

    def _pressure(self) -> np.ndarray:
        """Return nodal pressures [Pa] of the lifted space.

        They interpolate the run's nodal pressures. Without any, the pressure of a cell is the bulk
        stiffness times its mean change of volume, that of a vertex the mean over its cells.
        """
        problem, lifted = self.problem, self.lifted
        assert lifted.saddle_point is not None
        target = _dolfinx.function(lifted.saddle_point.Q, "pressure")
        if problem.saddle_point is not None:
            source = _dolfinx.function(problem.saddle_point.Q, "pressure")
            source.x.array[:] = problem.saddle_point.pressure()
        else:
            fields = problem.cell_fields(problem.x)
            volumes = fields["volume"]
            pressures = fields["deformed_volume"] / volumes - 1
            for part in lifted.elastic.parts:
                pressures[part.region.cells] *= part.loops.constants.volume_stiffness
            if lifted.saddle_point.cell_pressures:
                target.x.array[_dolfinx.node_dofs(target.function_space)[:, 0]] = pressures
                return np.asarray(target.x.array)
            source = _vertex_means(problem, volumes, pressures)
        target.interpolate(source)
        return np.asarray(target.x.array)


def _vertex_means(problem: Problem, volumes: np.ndarray, values: np.ndarray) -> object:
    """Return the function of degree 1 with the means over the cells of each vertex. Collective."""
    Q = _dolfinx.function_space(problem.domain, 1)
    sums, weights = (
        summed_over_cells(Q, cells[:, None, None]).ravel() for cells in (volumes * values, volumes)
    )
    function = _dolfinx.function(Q, "pressure")
    np.divide(sums, weights, out=function.x.array, where=weights > 0)
    return function


#: Taylor-Hood elements of degree 3, on which nothing but the estimate relies. Their quadrature is
#: exact for products of two gradients on affine cells.
_DEGREE_3 = (
    Element("P3P2", "tetrahedron", 3, 5, 4, "pressure", 2),
    Element("Q3Q2", "hexahedron", 3, 7, 6, "pressure", 2),
)
_DEGREE_2 = (ELEMENTS["P2P1"], ELEMENTS["Q2Q1"])
_POINTWISE = (ELEMENTS["P2"], ELEMENTS["Q2"])
#: lambda/mu up to which an element with a pointwise volume term does not lock: nu = 0.4, rounded.
_NO_LOCKING = 4.0 * (1 + 1e-9)
#: The same for P2 and P3 on triangles, nu = 0.499: beyond, Newton's method may find no state of P3.
_LITTLE_LOCKING = 500.0
#: lambda/mu up to which the lifted element has no unknown pressure either, nu = 1/3: the estimate
#: takes a quarter to two thirds of the time, and misses 0.01 to 0.1 more of the error
#: (docs/results/error.md).
_COMPRESSIBLE = 2.0 * (1 + 1e-9)
#: Mean number of nodes to which a node is connected in a large mesh of boxes, each of six
#: tetrahedra, or of rectangles of two triangles; and what a pair of nodes needs in bytes: each
#: number of its block (9 in three dimensions) in double precision for the matrix and in single
#: precision for the linear solver, and indices; and as much again for the couplings of the
#: pressure, their copies and temporary arrays (a run of twist, 16 cells, Q1P0).
_COUPLED_NODES = {("tetrahedron", 2): 28, ("tetrahedron", 3): 50, ("hexahedron", 2): 64,
                  ("hexahedron", 3): 125, ("triangle", 2): 12, ("triangle", 3): 17,
                  ("quadrilateral", 2): 16, ("quadrilateral", 3): 25}  # fmt: skip
_BYTES_PER_NUMBER, _BYTES_PER_BLOCK, _COPIES = 8 + 4, 8, 2


def lifted_elements(problem: Problem) -> Iterator[Element]:
    """Return the elements to which a problem is lifted, the best first.

    The further ones are for materials whose volume term has no unknown pressure, such as that in
    log(J): the mean dilatation of each cell where they are nearly incompressible.
    """
    base = problem.element
    best = _on_cells_of(problem, _DEGREE_2 if base.degree == 1 else _DEGREE_3)
    pointwise = replace(best, name=best.name[:2], volume="pointwise", pressure_degree=0)
    constant = replace(best, name=f"{best.name[:2]}P0", volume="mean", pressure_degree=0)
    several = len(problem.elastic.parts) > 1
    alike = base.volume == "pointwise" or base.degree == 1  # P2P0 is another element at a corner
    compressible = alike and not nearly_incompressible(problem, _COMPRESSIBLE)
    # Energies in UFL alone, or a rigid body, have no pressure; a sheet that thins does not lock.
    if not problem.elastic.parts or problem.kinematics.plane_stress or compressible:
        yield pointwise
        return
    if problem.operator != problem.A and base.volume != "pressure":  # condensed as the run is
        yield constant
    elif several and base.volume != "pressure":  # a continuous pressure is wrong at interfaces
        # P2 on triangles hardly locks, and P3 less: one pressure in each cell is a coarser element.
        triangles = base.name == "P2" and base.kinematics.dim == 2
        if not nearly_incompressible(problem, _LITTLE_LOCKING if triangles else _NO_LOCKING):
            yield pointwise
        yield replace(constant, volume="cell_pressure")
    else:
        yield best
    if nearly_incompressible(problem):
        yield constant
    else:
        yield pointwise


def _on_cells_of(problem: Problem, elements: Sequence[Element]) -> Element:
    """Return the one of some elements of three dimensions that has the problem's kind of cell."""
    in_same = [in_kinematics(element, problem.kinematics) for element in elements]
    return next(element for element in in_same if element.cell == problem.element.cell)


def nearly_incompressible(problem: Problem, limit: float = _NO_LOCKING) -> bool:
    """Return whether a pointwise volume term can lock with one of the materials.

    It can from a ``limit`` of lambda over mu on.
    """
    moduli = [part.region.material.lame for part in problem.elastic.parts]
    return any(not lam <= limit * mu for mu, lam in moduli)


def element_of_factor(problem: Problem, lifted: Element) -> Element | None:
    """Return the element of the problem's degree whose error `saturation` continues.

    It treats the volume as the lifted one does: a Taylor-Hood element, or one with the volume term
    at every point. None if the problem's own element does, or is as good: an element that locks has
    a larger error, and one pressure in each cell may have a smaller one. Elements of degree 1 have
    no factor, nor have lifted ones with one pressure in each cell.
    """
    base = problem.element
    if base.degree < 2:
        return None
    if lifted.volume == "pressure" and base.volume != "pressure":
        same = base.volume == "pointwise" and not may_lock(problem)
        return None if same else _on_cells_of(problem, _DEGREE_2)
    if lifted.volume == "pointwise" and base.volume == "mean":
        return _on_cells_of(problem, _POINTWISE)
    return None


def lifted_dofs(problem: Problem, element: Element) -> int:
    """Return the number of unknowns of the lifted problem. Collective."""
    count = partial(_dolfinx.num_nodes_of_degree, problem.domain)
    pressures = count(element.pressure_degree) if element.has_pressure else 0
    return element.kinematics.components * count(element.degree) + pressures


def memory(problem: Problem, element: Element) -> float:
    """Return about how many bytes the lifted problem needs on all ranks. Collective."""
    components = element.kinematics.components
    pairs = lifted_dofs(problem, element) / components
    pairs *= _COUPLED_NODES[element.cell, element.degree]
    return float(pairs * _COPIES * (components**2 * _BYTES_PER_NUMBER + _BYTES_PER_BLOCK))


def check_memory(problem: Problem, element: str, needed: float, most: float) -> None:
    """Raise NoEstimate if an element needs more than ``most`` or is available [bytes].

    Collective.
    """
    available = available_memory(problem.comm)
    if needed > min(available, most):
        limit = f"{most / 1e6:.3g} MB are allowed"
        if available < most:
            limit = f"{available / 1e6:.2g} MB are available"
        raise NoEstimate(f"{element} needs about {needed / 1e6:.2g} MB of memory, of which {limit}")


def available_memory(comm: Any) -> float:
    """Return the memory that is available to the ranks on all machines [bytes]. Collective."""
    return float(sum(dict(comm.allgather((os.uname().nodename, _available_here()))).values()))


def _available_here() -> float:
    """Return the memory that is available on this machine [bytes]; infinity if it is unknown."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            rows = dict(line.split(":") for line in lines)
        return float(rows["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return float("inf")
