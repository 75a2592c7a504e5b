"""The bases of energy terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

from petsc4py import PETSc

import numpy.typing as npt

from fem_snh.assembly.assembled_matrix import BlockMatrix

if TYPE_CHECKING:
    from fem_snh.geometry.motions import MovingShape


Array = npt.NDArray[Any]


class Term:
    """A part of a problem's energy, with its derivative: the base of all terms.

    A subclass has `add_residual`, `energy` if it has one, and what it needs of the rest, which has
    defaults. ``u`` and ``p`` are the ghosted vectors of the displacement and of the pressure,
    ``r_u`` and ``r_p`` those of the derivatives with respect to them. Without an unknown pressure
    ``p`` and ``r_p`` are None.

    Attributes
    ----------
    name : str
        The term's name in run.json.
    has_energy : bool
        Whether its forces are the gradient of its energy.
    depends_on_load : bool
        Whether it depends on the load parameter.
    stateless : bool
        Whether it keeps nothing from one evaluation to the next, so that two problems may share it.
    symmetric : bool
        Whether its exact Hessian, the derivative of its forces, is symmetric at any state.
    planar : bool
        Whether it supports meshes of two dimensions.
    has_penalties : bool
        Whether its forces are those of penalties, which act where something touches or leaks.
    is_contact : bool
        Whether it may hold a body where it touches something.
    eliminates : bool
        Whether its nodes follow a few unknowns: `fem_snh.terms.rigid_parts.RigidParts`.
    unsettled_penalty : float or None
        Which part of what its penalty changes of a goal stiffer ones may find otherwise; None for
        the default of pairs of surfaces.
    note : str
        What one should know of it beside "converged".
    """

    name: str = "term"
    has_energy: bool = True
    depends_on_load: bool = False
    stateless: bool = False
    symmetric: bool = True
    planar: bool = True
    has_penalties: bool = False
    is_contact: bool = False
    eliminates: bool = False
    unsettled_penalty: float | None = None
    note: str = ""

    @property
    def has_hessian(self) -> bool:
        """Whether the term's forces depend on the displacement."""
        return True

    @property
    def rounds_identity(self) -> bool:
        """Whether the energy is a UFL form of F = I + grad u, which rounds small strains."""
        return False

    @property
    def extent(self) -> float:
        """Size of the positions beside the body's that decide the term's forces [m]."""
        return 0.0

    @property
    def length_text(self) -> str:
        """What lengths the term has that depend on the space by default, with their size."""
        return ""

    @property
    def goals(self) -> Sequence[str]:
        """Names of results that may be goals of an error estimate, such as a force of contact.

        They are those of `fem_snh.terms.feature.Feature.goals`.
        """
        return ()

    @property
    def surfaces(self) -> Sequence[MovingShape]:
        """Surfaces of the term, which pictures show beside the body, in the order of run.json."""
        return ()

    def set_load(self, load: float) -> None:
        """Set the load parameter."""

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None) -> float:
        """Return the term's energy [J], summed over the ranks. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.energy")

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add dE/du to ``r_u`` and dE/dp to ``r_p``."""
        raise NotImplementedError(f"{type(self).__name__}.add_residual")

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the term's Hessian to a matrix, inside of `BlockMatrix.adding`.

        Parameters
        ----------
        u, p : PETSc.Vec
            Ghosted displacement and pressure; the ghosts are current.
        filter : {"exact", "clamp", "abs"}
            What becomes of negative eigenvalues.
        target : BlockMatrix
            The matrix; `BlockMatrix.add_matrices` adds element matrices to it.

        Returns
        -------
        int
            How many quadrature points or cells of this rank were filtered.
        """
        return 0

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of penalties; return whether there are any.

        Penalties leave an error that is inverse to their stiffness.
        """
        return False

    def share_lengths(self, other: Self) -> None:
        """Take over the lengths of the same term on another space."""

    def goal(self, name: str, u: PETSc.Vec) -> npt.NDArray[Any]:
        """Return the components of a result, (n,). Collective."""
        raise NotImplementedError(f"{type(self).__name__}.goal")

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative of a component to all entries of ``g``. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.add_goal_derivative")

    def record(self, u: PETSc.Vec) -> Mapping[str, Mapping[str, Any]]:
        """Return what the term adds to a step's row of run.json. Collective.

        A table of rows by name, under the key of run.json: {"cavities": {"inner": {...}}}.
        """
        return {}

    def nodal_field(self, name: str, u: PETSc.Vec) -> npt.NDArray[Any] | float:
        """Return a field of its feature, (nodes of this rank, components). Collective.

        Of a scalar it is (nodes,). Values of several terms are added; it is 0 of a field that the
        term does not have.
        """
        return 0.0


class ForceTerm(Term):
    """A term whose results are sums of nodal forces."""

    def add_nodal_forces(self, name: str, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the nodal forces [N] whose sum is a result to all entries of ``r``. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.add_nodal_forces")


class CouplingTerm(Term):
    """A term whose Hessian couples nodes that share no cell."""

    def couplings(self, u: PETSc.Vec) -> npt.NDArray[Any]:
        """Return the pairs of nodes that the Hessian at ``u`` couples. Collective.

        The (n, 2) array of `BlockMatrix.couple`; the same object while nothing changes.
        """
        raise NotImplementedError(f"{type(self).__name__}.couplings")


class WorkingTerm(Term):
    """A term whose loads move, or which dissipates energy, in a body in motion."""

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return the work of the term's moving loads in a step, and what it dissipated [J].

        It is called after the solution of a step, before `HistoryTerm.end_step`. Collective.

        Parameters
        ----------
        u : PETSc.Vec
            Ghosted displacement at the step's end.
        end_weight : float
            Weight of the forces at the step's end in the work that they do.
        """
        raise NotImplementedError(f"{type(self).__name__}.step_work")


class MeanForceTerm(Term):
    """A term whose forces a step in time has as means over the step: contact with obstacles."""

    def weight_mean_forces(self, weight: float | None) -> None:
        """Let the energy be that of the step's mean forces, times a weight.

        None: that of the present forces, as between steps.
        """
        raise NotImplementedError(f"{type(self).__name__}.weight_mean_forces")


class StepLimitingTerm(Term):
    """A term that admits only a part of some steps."""

    def largest_step(self, u: Array, d: Array) -> float:
        """Return a length in [0, 1] up to which all of the step u + s d is admissible. Collective.

        Parameters
        ----------
        u, d : (owned nodes, components)
            Displacement and step [m].
        """
        raise NotImplementedError(f"{type(self).__name__}.largest_step")


class StepLimit:
    """The largest admissible step of several terms.

    Parameters
    ----------
    terms : sequence of StepLimitingTerm
        The terms.
    num_nodes : int
        Number of displacement nodes that this rank owns.
    components : int, optional
        Components of the displacement.
    """

    def __init__(
        self, terms: Sequence[StepLimitingTerm], num_nodes: int, components: int = 3
    ) -> None:
        self._terms, self._num_nodes, self._components = list(terms), num_nodes, components

    @classmethod
    def of(cls, terms: Sequence[Term], num_nodes: int, components: int = 3) -> StepLimit | None:
        """Return the limit of those terms that have one; None if no term does."""
        limiting = [term for term in terms if isinstance(term, StepLimitingTerm)]
        return cls(limiting, num_nodes, components) if limiting else None

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec) -> float:
        """Return a length in [0, 1] up to which all of the step x + s d is admissible. Collective.

        ``x`` and ``d`` hold unknowns, the displacement's first.
        """
        size = self._components * self._num_nodes
        u, step = (v.array_r[:size].reshape(-1, self._components) for v in (x, d))
        return min(term.largest_step(u, step) for term in self._terms)
