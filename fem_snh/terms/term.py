"""The bases of energy terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

from petsc4py import PETSc

from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix

if TYPE_CHECKING:
    from fem_snh.geometry.motions import MovingShape


class Term:
    """A part of a problem's energy, with its derivative: the base of all terms.

    A subclass defines `add_residual`, and `energy` if ``has_energy``. All other methods have
    defaults. ``u`` and ``p`` are ghosted vectors of the displacement and the pressure, ``r_u`` and
    ``r_p`` of the derivatives by u and p. If the pressure is no unknown, ``p`` and ``r_p`` are
    None.

    Attributes
    ----------
    name : str
        The term's name in run.json.
    has_energy : bool
        Whether the term's forces are the gradient of an energy.
    depends_on_load : bool
        Whether the term depends on the load parameter.
    stateless : bool
        Whether the term keeps nothing from one evaluation to the next, so that two problems may
        share it.
    symmetric : bool
        Whether the exact Hessian, the derivative of the forces, is symmetric at any state.
    planar : bool
        Whether the term supports meshes of two dimensions.
    has_penalties : bool
        Whether a penalty stiffness determines the forces: contact, or the fluid of a cavity.
    is_contact : bool
        Whether the term may keep a body from moving rigidly, by contact.
    eliminates : bool
        Whether the displacements of some nodes are functions of a few unknowns, as in
        `fem_snh.terms.rigid_parts.RigidParts`.
    needs_aij : bool
        Whether `add_hessian` needs the problem's matrix in AIJ format.
    note : str
        A limitation that a user should know although the solver converges; empty for none.
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
    needs_aij: bool = False
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
        """Largest coordinate of obstacles [m], which bounds the rounding error of gaps; 0: none."""
        return 0.0

    @property
    def length_text(self) -> str:
        """A clause on a length of the term whose default depends on the mesh; empty for none."""
        return ""

    @property
    def goals(self) -> Sequence[str]:
        """Names of the results that may be goals of an error estimate, such as a contact force.

        They equal the names that `fem_snh.terms.feature.Feature.goals` returns.
        """
        return ()

    @property
    def surfaces(self) -> Sequence[MovingShape]:
        """Obstacles of the term, which pictures show beside the body, in the order of run.json."""
        return ()

    def set_load(self, load: float) -> None:
        """Set the load parameter."""

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None) -> float:
        """Return the term's energy [J], summed over the ranks. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.energy")

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add dE/du [N] to ``r_u`` and dE/dp to ``r_p``. Collective.

        The caller adds ghost entries to those of their owners.
        """
        raise NotImplementedError(f"{type(self).__name__}.add_residual")

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the term's Hessian to a matrix, inside of `BlockMatrix.adding`. Collective.

        Parameters
        ----------
        u : PETSc.Vec
            Ghosted displacement; the ghosts are current.
        p : PETSc.Vec or None
            Ghosted pressure, likewise.
        filter : {"exact", "clamp", "abs"}
            Whether negative eigenvalues are kept, set to zero, or replaced by their absolute value.
        target : BlockMatrix
            The matrix; `BlockMatrix.add_matrices` adds element matrices to it.

        Returns
        -------
        int
            The number of quadrature points or cells of this rank whose matrix was filtered.
        """
        return 0

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the penalty stiffness by ``factor``; return whether that changes the problem.

        The error that penalties leave is inversely proportional to their stiffness. With a factor
        of 1 the result is True for a term with a stiffness, and False for the barrier of
        self-contact, whose distance is divided by ``factor`` instead.
        """
        return False

    def share_lengths(self, other: Self) -> None:
        """Copy the lengths of `length_text` from ``other``, the same term on another space."""

    def goal(self, name: str, u: PETSc.Vec) -> Array:
        """Return the components (n,) of the result ``name``, one of `goals`. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.goal")

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative by u of a component of a result to ``g``. Collective.

        The caller adds ghost entries to those of their owners.
        """
        raise NotImplementedError(f"{type(self).__name__}.add_goal_derivative")

    def record(self, u: PETSc.Vec) -> Mapping[str, Mapping[str, Any]]:
        """Return what the term adds to a step's row of run.json. Collective.

        The result maps a key of run.json to rows by name: {"cavities": {"inner": {...}}}.
        """
        return {}

    def nodal_field(self, name: str, u: PETSc.Vec) -> Array | float:
        """Return the term's share of a nodal field, or 0 if it has no such field. Collective.

        It is (local nodes, components), or (local nodes,) for a scalar. The caller adds the shares
        of all terms.
        """
        return 0.0


class ForceTerm(Term):
    """A term whose results are sums of nodal forces."""

    def add_nodal_forces(self, name: str, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the nodal forces [N] whose sum is the result ``name`` to ``r``. Collective.

        The caller adds ghost entries to those of their owners.
        """
        raise NotImplementedError(f"{type(self).__name__}.add_nodal_forces")


class CouplingTerm(Term):
    """A term whose Hessian couples nodes that share no cell."""

    needs_aij = True

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of global nodes that the Hessian at ``u`` couples, (n, 2). Collective.

        `BlockMatrix.couple` describes them. The array is the same object while they do not change.
        """
        raise NotImplementedError(f"{type(self).__name__}.couplings")


class WorkingTerm(Term):
    """A term whose surfaces move and do work, or which dissipates energy, in a body in motion."""

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return the work done on the body in a step, and the dissipated energy [J]. Collective.

        The caller calls this method after the solution of a step, before `HistoryTerm.end_step`.

        Parameters
        ----------
        u : PETSc.Vec
            Ghosted displacement at the step's end.
        end_weight : float
            Weight in [0, 1] of the forces at the step's end; the forces at its start have the rest.
        """
        raise NotImplementedError(f"{type(self).__name__}.step_work")


class MeanForceTerm(Term):
    """A term that can use forces averaged over a time step: contact with obstacles."""

    def weight_mean_forces(self, weight: float | None) -> None:
        """Switch energy, residual and Hessian to the step's mean forces times ``weight``.

        None switches back to the forces at the present displacement, which hold between steps.
        """
        raise NotImplementedError(f"{type(self).__name__}.weight_mean_forces")


class StepLimitingTerm(Term):
    """A term that is undefined at some displacements, and so limits the length of steps."""

    def largest_step(self, u: Array, d: Array) -> float:
        """Return t in [0, 1] such that u + s d is admissible for all s in [0, t]. Collective.

        Parameters
        ----------
        u : (owned nodes, components) array
            Displacement [m].
        d : (owned nodes, components) array
            Step [m].
        """
        raise NotImplementedError(f"{type(self).__name__}.largest_step")


class StepLimit:
    """A function that returns the largest step which several terms admit.

    Parameters
    ----------
    terms : sequence of StepLimitingTerm
        The terms; at least one.
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
        """Return the step limit of the `StepLimitingTerm` among ``terms``; None without any."""
        limiting = [term for term in terms if isinstance(term, StepLimitingTerm)]
        return cls(limiting, num_nodes, components) if limiting else None

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec) -> float:
        """Return t in [0, 1] such that x + s d is admissible for all s in [0, t]. Collective.

        ``x`` and ``d`` are vectors of all unknowns, in which displacements precede pressures.
        """
        size = self._components * self._num_nodes
        u, step = (v.array_r[:size].reshape(-1, self._components) for v in (x, d))
        return min(term.largest_step(u, step) for term in self._terms)
