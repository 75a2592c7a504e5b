"""What the solver asks of a problem; `fem_snh.problem.problem.Problem` has it all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Regime(NamedTuple):
    """Size, shape and Poisson's ratio of a body: what a solver chooses its defaults by.

    Attributes
    ----------
    nodes : int
        Displacement nodes on all ranks.
    dimension : int
        Dimension of the mesh, 2 or 3.
    degree : int
        Degree of the displacement.
    section_nodes : float
        Their mean number in a section across the longest axis.
    poisson_ratio : float
        The largest Poisson's ratio of the materials, lambda / (2 lambda + 2 mu); 0 without
        materials, whose energies are UFL terms.
    inertia : bool
        Whether the Hessian contains a mass matrix.
    cell_aspect : float
        The mean ratio of a cell's largest to its smallest extent; 1 for a cube.
    supported : float
        The part of the longest axis along which nodes are constrained: about 0 for a bar that is
        clamped at its ends, 1 for one around a skeleton.
    constrained : float
        The part of the nodes that are constrained: all of a layer in plane strain.
    contrast : float
        The largest shear modulus of the materials over the smallest.
    contact : bool
        Whether a term has penalties or couples nodes without a common cell.
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
        """Return the unknowns of displacement and pressure, {"u": IS, "p": IS}."""

    @property
    def fields(self) -> Sequence[PETSc.Vec]:
        """Return the vectors of displacement and pressure, on communicators of their own."""

    @property
    def schur_approximation(self) -> PETSc.Mat:
        """Return a matrix that is spectrally equivalent to the Schur complement."""

    @property
    def cell_pressures(self) -> bool:
        """Return whether the pressure is constant in each cell."""

    @property
    def inverse_lumped_mass(self) -> Array:
        """Return the inverse of each pressure's share of the volume [1/m^3], (owned pressures,)."""

    def pressure_dofs(self, x: PETSc.Vec) -> Array:
        """Return a view of the owned pressures in a vector."""

    def update_schur_approximation(self, A: PETSc.Mat) -> None:
        """Adapt `schur_approximation` to the matrix ``A``. Collective."""


class CurvedPaths(Protocol):
    """Paths of steps: see `fem_snh.problem.regime.Paths`. Collective.

    Attributes
    ----------
    exact : bool
        Whether steps must end on the path. Entries of a step are then not displacements
        everywhere.
    """

    exact: bool

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set ``end`` to the end of a path from x along step d."""

    def move_rigidly(self, start: PETSc.Vec, x: PETSc.Vec) -> None:
        """Replace the motion of stiff parts from ``start`` to ``x`` by the nearest rigid one."""


class SolvableProblem(Protocol):
    """A minimisation problem, a saddle-point problem, or one of forces without an energy.

    Attributes
    ----------
    comm : communicator of mpi4py
    x : Vec
        The unknowns.
    A : Mat
        The matrix that `jacobian` assembles.
    operator : Mat
        The Hessian: ``A``, or the sum of ``A`` and matrices of low rank.
    length : float
        V^(1/3) [m], V the reference volume.
    force_scale : float
        E V^(2/3) [N]: the unit of the residual's norm.
    load : float
        The present load, in [0, 1].
    asymmetric : bool
        Whether the last matrix of `jacobian` is not symmetric.
    """

    comm: MPI.Intracomm
    x: PETSc.Vec
    A: PETSc.Mat
    operator: PETSc.Mat
    length: float
    force_scale: float
    load: float
    asymmetric: bool

    @property
    def symmetric(self) -> bool:
        """Return whether exact Hessians have no part that is not symmetric, at any state."""

    @property
    def has_energy(self) -> bool:
        """Return whether the residual is the gradient of an energy."""

    @property
    def regime(self) -> Regime:
        """Return what the linear solver is chosen by. Collective."""

    @property
    def largest_step(self) -> Callable[[PETSc.Vec, PETSc.Vec], float] | None:
        """Return a function, or None if every step is admissible.

        ``largest_step(x, d)`` returns a length in [0, 1] up to which all of the step x + s d is
        admissible. Collective.
        """

    @property
    def retraction(self) -> CurvedPaths | None:
        """Return the paths of steps, or None if they are straight."""

    @property
    def step_end(self) -> Callable[[PETSc.Vec], None] | None:
        """Return a function that sets what is constrained of a step's end, in place.

        None if it is constrained by components, which every solution of a linear system keeps.
        """

    def largest_force(self, x: PETSc.Vec) -> float:
        """Return the largest norm of a term's forces [N]. Collective.

        Those on constrained unknowns count as well.
        """

    def rounding_force(self, x: PETSc.Vec, least: float = 0.0) -> float:
        """Return a bound of the residual's rounding error [N]; 0 where it is below ``least``.

        The Hessian is the one assembled last. Collective.
        """

    @property
    def pressure_level_is_free(self) -> bool:
        """Whether an unknown pressure is determined up to a constant only. Collective."""

    @property
    def saddle_point(self) -> SaddlePoint | None:
        """Return the pressure's part of a saddle-point problem, or None."""

    @property
    def coordinates(self) -> Array:
        """Return the reference coordinates [m] of this rank's own nodes, (n, 3)."""

    def energy(self, x: PETSc.Vec) -> float:
        """Return the energy [J]; +inf outside the material's domain. Collective."""

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Assemble the energy's gradient [N], zero at constrained unknowns. Collective."""

    def jacobian(self, x: PETSc.Vec, filter: str, whole: bool = False) -> int:
        """Assemble the filtered Hessian into ``A``; return the number of filtered points.

        An exact one has the symmetric parts of forces without an energy, or their ``whole``
        derivatives.
        """

    def update_lagged(self) -> bool:
        """Update what is constant in a solve, at ``x``; return whether to solve again. Collective.

        It raises `NotSettled` on every rank if that does not settle.
        """

    def set_load(self, load: float) -> None:
        """Set the load."""

    def prescribe(self, x: PETSc.Vec) -> None:
        """Set the constrained unknowns to their boundary values at the present load."""

    def project(self, values: Array) -> None:
        """Set what is constrained of this rank's part of a vector to zero, in place."""
