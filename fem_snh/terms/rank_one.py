"""Terms whose Hessian has a dense matrix of rank one, which is applied without assembling it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.terms.term import Term


class RankOneTerm(Term):
    """A term with the energy p^2/(2 k) of a scalar p(u), and forces p g with g = (dp/du) / k.

    The Hessian is k g g^T + p dg/du. Away from equilibrium, the p of a stiff term may be orders of
    magnitude larger than p at equilibrium; the sparse part of the Hessian therefore uses another p.

    Attributes
    ----------
    imbalance : float
        The difference c of the sparse part (p + c) dg/du, which `RankOneUpdate.update` sets.
    """

    imbalance: float = 0.0

    def rank_one(self, u: PETSc.Vec, g: PETSc.Vec) -> float:
        """Set ``g`` to g or -g at u, ghosts included, and return k >= 0. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.rank_one")


class RankOneUpdate:
    """The sum of an assembled matrix and matrices k g g^T, as PETSc's MATLRC. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        The assembled matrix, which is not copied.
    V : dolfinx function space
        The displacement's space.
    terms : sequence of RankOneTerm
        The terms with matrices k g g^T.
    project : callable
        Sets the constrained entries of this rank's part of a vector to zero, in place.

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
        project: Callable[[Array], None],
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
        A: Callable[[], PETSc.Mat],
        V: _dolfinx.FunctionSpace,
        project: Callable[[Array], None],
    ) -> RankOneUpdate | None:
        """Return the update of the `RankOneTerm` in ``terms``; None, without ``A()``, for none."""
        found = [term for term in terms if isinstance(term, RankOneTerm)]
        return cls(A(), V, found, project) if found else None

    def update(
        self, u: PETSc.Vec, force: PETSc.Vec, reduce: Callable[[PETSc.Vec], None] | None = None
    ) -> None:
        """Set k and g in `mat` at ``u``, and the terms' imbalances. Collective.

        The sums p + c, c the imbalances, are the least-squares multipliers that balance the forces
        of all other terms (Nocedal & Wright 2006, eq. 18.21). At equilibrium they are p, for any k.

        Parameters
        ----------
        u : PETSc.Vec
            The ghosted displacement.
        force : PETSc.Vec
            The forces dE/du of all terms [N]; on return with p + c instead of p.
        reduce : callable, optional
            Turns derivatives by nodal displacements into derivatives by the unknowns of rigid
            parts, in place.
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

    def _reduced(self, g: PETSc.Vec, reduce: Callable[[PETSc.Vec], None] | None) -> Array:
        """Return this rank's part of ``g``, changed in place to a derivative by free unknowns."""
        if reduce:
            reduce(g)
        self._project(g.array)
        return np.asarray(g.array_r)
