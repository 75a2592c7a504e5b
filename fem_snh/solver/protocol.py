"""Interfaces that the solver requires; `fem_snh.problem.problem.Problem` implements them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from mpi4py import MPI
from petsc4py import PETSc

from fem_snh.arrays import Array


class Regime(NamedTuple):
    """Properties of a problem by which the linear solver is chosen.

    Attributes
    ----------
    nodes : int
        Displacement nodes on all ranks.
    dimension : int
        Dimension of the mesh, 2 or 3.
    degree : int
        Degree of the displacement.
    section_nodes : float
        Mean number of nodes in a section across the longest axis; infinity without materials.
    poisson_ratio : float
        The largest Poisson's ratio of the materials, lambda / (2 lambda + 2 mu); 0 without
        materials, if all energies are UFL forms.
    inertia : bool
        Whether the Hessian contains a mass matrix.
    cell_aspect : float
        The mean ratio of a cell's largest to its smallest extent; 1 for a cube.
    supported : float
        The fraction of the longest axis along which nodes are constrained: about 0 for a bar that
        is clamped at its ends, 1 for a bar around a skeleton.
    constrained : float
        The fraction of the nodes with a constrained component; 1 for a layer in plane strain.
    contrast : float
        The largest shear modulus of the materials over the smallest; 1 without materials.
    contact : bool
        Whether a term has penalties: contact, or an enclosed fluid.
    """

    nodes: int
    dimension: int
    degree: int
    section_nodes: float
    poisson_ratio: float
    inertia: bool
    cell_aspect: float = 1.0
    supported: float = 0.0
    constrained: float = 0.0
    contrast: float = 1.0
    contact: bool = False


class SaddlePoint(Protocol):
    """A saddle-point problem: its energy has a minimum in u and a maximum in the pressure."""

    @property
    def index_sets(self) -> Mapping[str, PETSc.IS]:
        """Return the global indices of displacement and pressure, {"u": IS, "p": IS}."""

    @property
    def fields(self) -> Sequence[PETSc.Vec]:
        """Return the vectors of displacement and pressure, each with its own communicator."""

    @property
    def schur_approximation(self) -> PETSc.Mat:
        """Return an approximation of the Schur complement -(B H^-1 B^T + C), negative definite."""

    @property
    def cell_pressures(self) -> bool:
        """Return whether the pressure is constant in each cell."""

    @property
    def inverse_lumped_mass(self) -> Array:
        """Return the inverse of the lumped pressure mass matrix, (owned pressures,)."""

    def pressure_dofs(self, x: PETSc.Vec) -> Array:
        """Return a view of the pressures in ``x`` that this rank owns."""

    def update_schur_approximation(self, A: PETSc.Mat) -> None:
        """Update `schur_approximation` for the assembled Hessian ``A``. Collective."""


class CurvedPaths(Protocol):
    """Curved paths of the nodes in a step (`fem_snh.problem.regime.Paths`). Collective.

    Attributes
    ----------
    exact : bool
        Whether steps must end on the path, as with rigid parts, where the entries of a step are
        rigid motions instead of displacements.
    """

    exact: bool

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set ``end`` to the end of the path from ``x`` with the increment ``step`` times ``d``."""

    def move_rigidly(self, start: PETSc.Vec, x: PETSc.Vec) -> None:
        """Change ``x`` so that stiff and rigid parts move rigidly from ``start`` to ``x``."""


class SolvableProblem(Protocol):
    """A minimisation problem, a saddle-point problem, or a balance of forces without an energy.

    Attributes
    ----------
    comm : communicator of mpi4py
    x : Vec
        The unknowns.
    P : Mat
        The matrix that `jacobian` assembles.
    operator : Mat
        The Hessian: ``P``, or the sum of ``P`` and matrices of low rank.
    length : float
        V^(1/3) [m], V the reference volume; on a plane the square root of the area.
    force_scale : float
        E V^(2/3) [N], E the scale of the moduli: the unit of the residual's norm.
    load : float
        The present load, in [0, 1].
    asymmetric : bool
        Whether the matrix that `jacobian` assembled last is not symmetric.
    """

    comm: MPI.Intracomm
    x: PETSc.Vec
    length: float
    force_scale: float
    load: float
    asymmetric: bool

    @property
    def P(self) -> PETSc.Mat:
        """Return the matrix; the first access makes it. Collective."""

    @property
    def operator(self) -> PETSc.Mat:
        """Return the Hessian. Collective."""

    @property
    def is_assembled(self) -> bool:
        """Return whether the Hessian is ``P`` alone."""

    def store_half(self) -> None:
        """Let ``P`` be stored as `EisenstatCG` reads it, if it is not made yet and may be."""

    @property
    def symmetric(self) -> bool:
        """Return whether the exact Hessian is symmetric at every state."""

    @property
    def has_energy(self) -> bool:
        """Return whether the residual is the gradient of an energy."""

    @property
    def regime(self) -> Regime:
        """Return the properties by which the linear solver is chosen. Collective."""

    @property
    def largest_step(self) -> Callable[[PETSc.Vec, PETSc.Vec], float] | None:
        """Return a function of ``x`` and ``d``, or None if every step is admissible.

        ``largest_step(x, d)`` returns a length s in [0, 1] such that x + t d is admissible for all
        t in [0, s]. The call is collective.
        """

    @property
    def retraction(self) -> CurvedPaths | None:
        """Return the curved paths of steps, or None if all steps are straight."""

    @property
    def step_end(self) -> Callable[[PETSc.Vec], None] | None:
        """Return a function that sets the constrained unknowns of a step's end in place, or None.

        None if only components are constrained, which are zero in every search direction. An
        inexact direction leaves an inclined plane.
        """

    def largest_force(self, x: PETSc.Vec) -> float:
        """Return the largest 2-norm of a term's forces at ``x`` [N]. Collective.

        Forces on constrained unknowns are included.
        """

    def rounding_force(self, x: PETSc.Vec, least: float = 0.0) -> float:
        """Return a bound of the 2-norm of the residual's rounding error at ``x`` [N]. Collective.

        It uses the Hessian assembled last. The result is 0 if a simpler bound is below ``least``.
        """

    @property
    def pressure_level_is_free(self) -> bool:
        """Return whether the pressure is determined only up to a constant. Collective."""

    @property
    def saddle_point(self) -> SaddlePoint | None:
        """Return the pressure block of a saddle-point problem; None for other problems."""

    @property
    def coordinates(self) -> Array:
        """Return the reference coordinates [m] of the nodes that this rank owns, (n, 3)."""

    @property
    def kinematics(self) -> Any:
        """Return the displacement's `fem_snh.assembly.kinematics.Kinematics`."""

    def nodal(self, x: PETSc.Vec) -> Array:
        """Return a read-only view of the displacement in ``x``, (owned nodes, components) [m]."""

    def energy(self, x: PETSc.Vec) -> float:
        """Return the energy [J]; +inf outside the material's domain. Collective."""

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Set ``r`` to the energy's gradient [N], zero at constrained unknowns. Collective."""

    def jacobian(self, x: PETSc.Vec, filter: str, whole: bool = False) -> int:
        """Assemble the Hessian into ``P``; return the number of filtered points. Collective.

        ``filter`` is one of `fem_snh.choices.FILTERS`. Forces without an energy add the symmetric
        part of their derivative, or, if ``whole`` and the filter is "exact", all of it.
        """

    def update_lagged(self) -> bool:
        """Update the lagged quantities at ``x``; return whether to solve again. Collective.

        Multipliers and friction are lagged: constant in a solve. Raises `NotSettled` on every rank
        if they do not settle.
        """

    def set_load(self, load: float) -> None:
        """Set the load, in [0, 1]."""

    def prescribe(self, x: PETSc.Vec) -> None:
        """Set the constrained unknowns of ``x`` to their boundary values at the present load."""

    def project(self, values: Array) -> None:
        """Set the constrained components of ``values``, this rank's part of a vector, to zero."""
