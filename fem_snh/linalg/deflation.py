"""A coarse space that conjugate gradients are spared: it is solved for exactly, on every rank."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from fem_snh.linalg.block_matrix import Blocks
from fem_snh.linalg.coarse_space import MODES, Coarse, bisect, linear
from fem_snh.linalg.halo import Halo

Array = npt.NDArray[Any]

_Reason = PETSc.KSP.ConvergedReason
#: The coarse matrix is scaled to a unit diagonal, but for what is softer than the rest by this.
_SOFT = 1e-5
#: An eigenvalue of what that gives that is rounding, as that of a rigid motion.
_FLAT = 1e-10


class Deflation:
    """Deflated conjugate gradients (Nicolaides 1987; Saad, Yeung, Erhel, Guyomarc'h 2000).

    The nodes are in parts; the columns of Z are displacements that in one part are linear functions
    of the place at rest, and zero elsewhere. With E = Z^T A Z, Q = Z E^-1 Z^T and P = 1 - A Q, a
    method for P A x = P b gives A^-1 b = Q b + P^T x. What converges slowly is rigid motions and
    stretches of whole regions, on any mesh and any number of ranks, and P A knows nothing of them.
    As every linear function is there, so are the rotations of a body that is already deformed.

    Parameters
    ----------
    near, far : the pattern, as `Coarse` takes it.
    places : (rows, 3) where this rank's nodes are at rest.
    parts : how many, on all ranks; each has one at least.

    Vectors are (3 rows,), single precision, as C pointers. Collective.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        blocks: Blocks,
        near: tuple[Array, Array],
        far: tuple[Array, Array] | None,
        halo: Halo | None,
        places: Array,
        parts: int,
    ) -> None:
        self._comm, self._blocks, self._halo, self._places = comm, blocks, halo, places
        rows = len(places)
        share = round(parts * rows / max(1, comm.allreduce(rows)))
        self._own = min(rows, max(1, share))
        counts = comm.allgather(self._own)
        self._first = sum(counts[: comm.rank])
        part = self._first + bisect(places, self._own)
        if halo:
            halo.exchange(np.repeat(part, 3).astype(np.float32))  # exact up to 2^24
            part = np.concatenate([part, halo.ghosts[:, 0]])
        self._coarse = Coarse(blocks, near, far, part.astype(np.int32), sum(counts))
        self._free: Array | None = None
        size = MODES * sum(counts)
        self._y, self._single, self._c = np.zeros(size), np.zeros(size, np.float32), np.zeros(size)
        self._at_y, self._at_single = blocks.pointer(self._y), blocks.pointer(self._single)

    @property
    def nbytes(self) -> int:
        """What this rank keeps of A Z, and reads twice in an iteration."""
        return self._coarse.nbytes

    def take(self, values: int, far: int, scale: float) -> int:
        """Take an AIJ matrix's values, at these addresses, times ``scale``.

        Returns 0, or PETSc's reason why there is no solution: E tells that it is indefinite.
        """
        self._update_modes(self._coarse.coupled(values, far))
        mine = self._coarse.fill(values, far, scale, self._first, self._own)
        E = np.concatenate(self._comm.allgather(mine))
        if not np.isfinite(E).all():
            return int(_Reason.DIVERGED_NANORINF)
        inverse = _inverse(E)
        if inverse is None:
            return int(_Reason.DIVERGED_INDEFINITE_MAT)
        self._inverse = inverse
        return 0

    def start(self, r: Any) -> None:
        """P b in place of ``r`` = b; `finish` adds Q b."""
        self._c[:] = self._solve("restrict", r)
        self._blocks.lib.coarse_subtract(self._coarse.struct, self._at_single, r)

    def project(self, t: Any, w: Any) -> None:
        """w -= A Q A t."""
        self._solve("gather", t)
        self._blocks.lib.coarse_subtract(self._coarse.struct, self._at_single, w)

    def finish(self, x: Any) -> None:
        """Q b + P^T x in place of ``x``."""
        self._single[:] = self._c - self._solve("gather", x)
        self._blocks.lib.coarse_prolong(self._coarse.struct, self._at_single, x)

    def _solve(self, of: str, vector: Any) -> Array:
        """E^-1 Z^T times a vector ("restrict"), or E^-1 Z^T A ("gather"); also in _single."""
        self._y[:] = 0
        getattr(self._blocks.lib, f"coarse_{of}")(self._coarse.struct, vector, self._at_y)
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, self._y)
        found: Array = self._inverse @ self._y
        self._single[:] = found
        return found

    def _update_modes(self, free: Array) -> None:
        """Make Z anew if others than before are the unknowns that are coupled to any."""
        same = self._free is not None and np.array_equal(free, self._free)
        if self._comm.allreduce(same, op=MPI.LAND):
            return
        rows, modes = self._blocks.rows, self._coarse.modes
        modes[:rows] = linear(self._places, self._coarse.part[:rows], free)
        self._free = free
        if self._halo:
            for k in range(modes.shape[2]):
                self._halo.exchange(np.ascontiguousarray(modes[:rows, :, k]).ravel())
                modes[rows:, :, k] = self._halo.ghosts


def _inverse(E: Array) -> Array | None:
    """The inverse of a symmetric matrix, or None if it has a negative eigenvalue.

    Of one that is singular, that of its part beside the null space.
    """
    diagonal = E.diagonal()
    largest = diagonal.max(initial=0.0)
    if largest <= 0:
        return None if diagonal.any() else np.zeros_like(E)
    size = np.sqrt(np.maximum(diagonal, _SOFT * largest))
    E = E / np.outer(size, size) + np.diag(diagonal == 0.0)  # that is of functions that are zero
    factor, bad = lapack.dpotrf(E, lower=1)
    if not bad:
        lower, bad = lapack.dpotri(factor, lower=1)
        inverse = np.tril(lower) + np.tril(lower, -1).T
    if bad or inverse.trace() > 1 / _FLAT:
        found, vectors = np.linalg.eigh((E + E.T) / 2)
        if found[0] < -_FLAT:
            return None
        good = found > _FLAT
        inverse = (vectors[:, good] / found[good]) @ vectors[:, good].T
    return np.asarray(inverse / np.outer(size, size))
