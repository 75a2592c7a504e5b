"""Steps that must not be taken as a whole, as their path would cross what their end does not show.

The barrier of self-contact keeps surfaces apart; a step that carries one through the other ends in
a state that looks admissible. Line search, trust region and predictor therefore ask for the largest
step that is admissible along its whole path (Li et al. 2020, section 3: continuous collision
detection).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy.typing as npt

from fem_snh.terms.term import Term

Array = npt.NDArray[Any]


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
