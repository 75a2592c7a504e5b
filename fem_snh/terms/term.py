"""The interface of an energy term."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, Self, runtime_checkable

from petsc4py import PETSc

import numpy.typing as npt

from fem_snh.assembly.assembled_matrix import BlockMatrix


@runtime_checkable
class Term(Protocol):
    """A part of a problem's energy, with its derivative.

    A term with ``stateless = True`` keeps nothing from one evaluation to the next; one with
    ``symmetric = False`` may have an exact Hessian, the derivative of its forces, that is not
    symmetric.

    ``u`` and ``p`` are the ghosted vectors of the displacement and of the pressure, ``r_u`` and
    ``r_p`` those of the derivatives with respect to them. Without an unknown pressure ``p`` and
    ``r_p`` are None.
    """

    @property
    def name(self) -> str:
        """The term's name in run.json."""

    @property
    def has_energy(self) -> bool:
        """Whether the term's forces are the gradient of its energy."""

    @property
    def depends_on_load(self) -> bool:
        """Whether the term depends on the load parameter."""

    def set_load(self, load: float) -> None:
        """Set the load parameter."""

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None) -> float:
        """Return the term's energy [J], summed over the ranks. Collective."""

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add dE/du to ``r_u`` and dE/dp to ``r_p``."""

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


@runtime_checkable
class PenaltyTerm(Protocol):
    """A term with penalties, which leave an error that is inverse to their stiffness."""

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of penalties; return whether there are any."""


@runtime_checkable
class LengthTerm(Protocol):
    """A term with lengths that depend on the space by default.

    Attributes
    ----------
    length_text : str
        What they are, with their size.
    """

    @property
    def length_text(self) -> str: ...

    def share_lengths(self, other: Self) -> None:
        """Take over the lengths of the same term on another space."""


@runtime_checkable
class GoalTerm(Protocol):
    """A term with results that may be goals of an error estimate, such as a force of contact."""

    @property
    def goals(self) -> Sequence[str]:
        """The results' names, those of `fem_snh.terms.feature.Feature.goals`."""

    def goal(self, name: str, u: PETSc.Vec) -> npt.NDArray[Any]:
        """Return the components of a result, (n,). Collective."""

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative of a component to all entries of ``g``. Collective."""


@runtime_checkable
class ForceTerm(GoalTerm, Protocol):
    """A term whose results are sums of nodal forces."""

    def add_nodal_forces(self, name: str, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the nodal forces [N] whose sum is a result to all entries of ``r``. Collective."""
