"""Matrices of rank one that terms add to the Hessian without assembling them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.terms.term import Term


class RankOneTerm(Term):
    """A term with the energy p^2/(2 k) of a scalar p, so that its forces are p g, g = dp/du / k.

    Its Hessian is k g g^T + p dg/du. Where the forces do not balance, p is no estimate of that at
    equilibrium: of a stiff term it is larger by orders of magnitude.

    Attributes
    ----------
    imbalance : float
        What the sparse part p dg/du has in addition to p.
    """

    imbalance: float = 0.0

    def rank_one(self, u: PETSc.Vec, g: PETSc.Vec) -> float:
        """Set the ghosted vector ``g`` and return k >= 0. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.rank_one")


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
        V: _dolfinx.FunctionSpace,
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
        cls,
        terms: Sequence[Any],
        A: PETSc.Mat,
        V: _dolfinx.FunctionSpace,
        project: Callable[[npt.NDArray[Any]], None],
    ) -> RankOneUpdate | None:
        """Return the update of those terms that have such a matrix; None if none has one."""
        found = [term for term in terms if isinstance(term, RankOneTerm)]
        return cls(A, V, found, project) if found else None

    def update(
        self, u: PETSc.Vec, force: PETSc.Vec, reduce: Callable[[PETSc.Vec], None] | None = None
    ) -> None:
        """Evaluate the terms at a ghosted displacement, and set their imbalances. Collective.

        With these the terms' scalars are the least-squares multipliers of the other forces (Nocedal
        & Wright 2006, eq. 18.21): at equilibrium their own, whatever k is.

        Parameters
        ----------
        u : PETSc.Vec
            The displacement.
        force : PETSc.Vec
            The forces dE/du of all terms; on return those with the multipliers.
        reduce : callable, optional
            Replaces a derivative by displacements by that by fewer unknowns, in place.
        """
        owned, U = self._g.getLocalSize(), self._U.getDenseArray()
        columns = []
        for number, term in enumerate(self._terms):
            self._factors.array[number] = term.rank_one(u, self._g)
            columns.append(np.array(self._g.array_r))
            U[:owned, number] = self._reduced(self._g, reduce)  # zero for an unknown pressure
        self._g.array = force.array_r[:owned]
        rows = np.column_stack([U[:owned], self._reduced(self._g, reduce)])
        sums = self._U.comm.tompi4py().allreduce(rows.T @ rows)
        if not np.isfinite(sums).all():  # a state outside of the material's domain
            sums[:] = 0.0
        found = np.linalg.lstsq(sums[:-1, :-1], -sums[:-1, -1], rcond=None)[0]
        for term, imbalance, column in zip(self._terms, found, columns, strict=True):
            term.imbalance = float(imbalance)
            force.array[:owned] += imbalance * column
        self._U.assemble()
        self.mat.assemble()

    def _reduced(
        self, g: PETSc.Vec, reduce: Callable[[PETSc.Vec], None] | None
    ) -> npt.NDArray[Any]:
        """Return this rank's part of a derivative by the free unknowns; it changes ``g``."""
        if reduce:
            reduce(g)
        self._project(g.array)
        return np.asarray(g.array_r)
