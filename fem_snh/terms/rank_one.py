"""Matrices of rank one that terms add to the Hessian without assembling them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx


@runtime_checkable
class RankOneTerm(Protocol):
    """A term whose Hessian has a part k g g^T beside the sparse one."""

    def rank_one(self, u: PETSc.Vec, g: PETSc.Vec) -> float:
        """Set the ghosted vector ``g`` and return k >= 0. Collective."""


class RankOneUpdate:
    """The sum of an assembled matrix and matrices of rank one, as PETSc's MATLRC. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        The assembled matrix.
    V : dolfinx function space
        The displacement's space.
    terms : sequence of RankOneTerm
        The terms that have such matrices.
    project : callable
        Sets what is constrained of this rank's part of a vector to zero, in place.

    Attributes
    ----------
    mat : PETSc.Mat
        The sum.
    """

    def __init__(
        self,
        A: PETSc.Mat,
        V: Any,
        terms: Sequence[RankOneTerm],
        project: Callable[[npt.NDArray[Any]], None],
    ) -> None:
        self._terms, self._project = list(terms), project
        self._g = _dolfinx.create_vector(V)
        rows = A.getSizes()[0]
        columns = (PETSc.DECIDE, len(self._terms))
        self._U = PETSc.Mat().createDense((rows, columns), comm=A.comm)
        self._U.setUp()
        self._U.assemble()
        self._factors = PETSc.Vec().createSeq(len(self._terms), comm=PETSc.COMM_SELF)
        self.mat = PETSc.Mat().createLRC(A, self._U, self._factors, self._U)

    @classmethod
    def of(
        cls, terms: Sequence[Any], A: PETSc.Mat, V: Any, project: Callable[[npt.NDArray[Any]], None]
    ) -> RankOneUpdate | None:
        """Return the update of those terms that have such a matrix; None if none has one."""
        found = [term for term in terms if isinstance(term, RankOneTerm)]
        return cls(A, V, found, project) if found else None

    def update(self, u: PETSc.Vec, reduce: Callable[[PETSc.Vec], None] | None = None) -> None:
        """Evaluate the terms at a ghosted displacement. Collective.

        ``reduce`` replaces a derivative by displacements by that by fewer unknowns, in place.
        """
        for column, term in enumerate(self._terms):
            self._factors.array[column] = term.rank_one(u, self._g)
            if reduce:
                reduce(self._g)
            self._project(self._g.array)
            own = np.asarray(self._g.array_r)
            self._U.getDenseArray()[: len(own), column] = own  # zero for an unknown pressure
        self._U.assemble()
        self.mat.assemble()
