"""A sum of UFL terms, as a base of the terms of a scene that have several surfaces."""

from __future__ import annotations

from petsc4py import PETSc

from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.terms.term import Term
from fem_snh.terms.ufl_term import UFLTerm


class UFLTerms(Term):
    """Forces and Hessian of several `UFLTerm`: UFL accepts one set of marked facets per form.

    Subclasses set the list ``_terms``.
    """

    stateless = True
    _terms: list[UFLTerm]

    @property
    def symmetric(self) -> bool:
        """Whether the exact Hessian has the symmetric parts of the terms' derivatives alone."""
        return all(term.symmetric for term in self._terms)

    @symmetric.setter
    def symmetric(self, value: bool) -> None:
        for term in self._terms:
            term.symmetric = value

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to all entries of ``r_u``, ghosts included. Collective."""
        for term in self._terms:
            term.add_residual(u, p, r_u, r_p)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the filtered Hessian; return how many facets of this rank were filtered."""
        return sum(term.add_hessian(u, p, filter, target) for term in self._terms)
