r"""The Schur complement of continuous pressures, approximated by a weighted mass matrix.

By the inf-sup condition :math:`B H^{-1} B^T` is spectrally equivalent to the mass matrix divided by
the shear modulus, for any Poisson's ratio. The weights depend on constraints and strains.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import aij_blocks, nonzero_state
from fem_snh.linalg.block_matrix import Halo
from fem_snh.problem.mixed.pressure_masses import PressureMasses

#: Factor of the shear part of the Schur complement's approximation. In the interior 1 would be
#: right, but at clamped boundaries and large strains it is too small, which costs more iterations
#: than an approximation that is too large (docs/results/elements_taylor_hood.md).
_SCALE = 1.5


class NodalSchur:
    """The approximation of the Schur complement, as a negative definite matrix. Collective.

    Parameters
    ----------
    masses : PressureMasses
    num_u : int
        Number of displacement dofs that this rank owns, its first rows.
    idle : (n,) int
        The owned pressures, numbered from 0, that are in no assembled cell: their rows of the
        matrix have a diagonal entry alone.

    Attributes
    ----------
    matrix : PETSc.Mat
        The approximation, (pressures, pressures). Before the first `update` it is the mass matrix
        with the coefficient -(1/mu + 1/U''(1)).
    """

    def __init__(self, masses: PressureMasses, num_u: int, idle: np.ndarray) -> None:
        self._masses, self._num_u, self._idle = masses, num_u, idle
        self._halo: tuple[tuple[int, int], Halo] | None = None
        self.matrix = masses.shear_compliance.matrix.copy()
        self.matrix.scale(-masses.shear_compliance.scale)
        self._subtract_volume_compliance()

    def update(self, A: PETSc.Mat) -> None:
        r"""Compute the approximation for the Hessian ``A``, scaled by local compliance. Collective.

        Constrained nodes and large strains reduce :math:`B H^{-1} B^T` locally. The scaling uses

        .. math:: d = \mathrm{diag}(B D^{-1} B^T) / \mathrm{diag}(M), \quad D = \mathrm{diag}(H)

        (as in the SIMPLE method), with the mass matrix M of coefficient 1/mu. In the interior of an
        unstrained region d is constant, and :math:`B H^{-1} B^T = M / (2 + \lambda_{local}/\mu)`.
        With s = d / (2 mean d), the factor of M is ``_SCALE`` times s / (1 + s lambda_local/mu),
        which has the interior value at s = 1/2. Pressures without a free node have s = 1/2: at
        nu = 1/2 their rows of A are zero, but the approximation has to be definite. Rows of idle
        pressures get the diagonal of A.

        Parameters
        ----------
        A : PETSc.Mat
            The assembled Hessian.
        """
        d = self._diagonal_of_schur_complement(A)
        shear = self._masses.shear_compliance
        mass = shear.matrix.getDiagonal().array_r
        sums = A.comm.tompi4py().allreduce(np.array([d.sum(), np.delete(mass, self._idle).sum()]))
        s = d / mass * sums[1] / (2 * sums[0]) if sums[0] else np.zeros(len(d))
        s[d == 0] = 0.5
        ratio = self._masses.lambda_over_mu
        factor = _SCALE * s / (1 + s * ratio)
        root = shear.matrix.createVecLeft()
        root.array[:] = np.sqrt(factor)
        root.array[self._idle] = 0.0
        shear.matrix.copy(self.matrix)
        self.matrix.diagonalScale(root, root)
        self.matrix.scale(-shear.scale)
        self._subtract_volume_compliance()
        own = self.matrix.getDiagonal()
        own.array[self._idle] = A.getDiagonal().array[self._num_u + self._idle]
        self.matrix.setDiagonal(own)

    def _subtract_volume_compliance(self) -> None:
        """Subtract C of the undeformed body from the approximation."""
        same, volume = PETSc.Mat.Structure.SAME_NONZERO_PATTERN, self._masses.volume_compliance
        self.matrix.axpy(-volume.scale, volume.matrix, same)

    def _diagonal_of_schur_complement(self, A: PETSc.Mat) -> np.ndarray:
        """Return diag(B D^-1 B^T), (owned pressures,). Collective."""
        num_u, local = self._num_u, A.getDiagonal().array
        local[:num_u] = 1 / np.abs(local[:num_u])
        local[num_u:] = 0.0  # of C
        d = np.zeros(len(local) - num_u)
        with aij_blocks(A, read_only=True) as blocks:
            for k, block in enumerate(blocks):
                weight = local
                if k:
                    halo = self._halo_of(A, block.ghosts)
                    halo.exchange(local)
                    weight = halo.ghosts.ravel()
                start, column = block.csr()
                entries, length = slice(start[num_u], start[-1]), np.diff(start[num_u:])
                terms = block.array()[entries] ** 2 * weight[column[entries]]
                filled = length > 0
                if filled.any():
                    d[filled] += np.add.reduceat(terms, start[num_u:-1][filled] - start[num_u])
        return d

    def _halo_of(self, A: PETSc.Mat, ghosts: np.ndarray) -> Halo:
        """Return the exchange of one value for each ghost column of the pattern. Collective."""
        if self._halo is None or self._halo[0] != nonzero_state(A):
            comm, first = A.comm.tompi4py(), A.getOwnershipRanges()
            self._halo = nonzero_state(A), Halo(comm, first, ghosts, 1, np.float64)
        return self._halo[1]
