r"""The Schur complement of pressures that are constant in each cell.

The mass matrix that serves Taylor-Hood elements is not spectrally equivalent to
:math:`B H^{-1} B^T` here: pressures that nearly alternate from cell to cell (Q1P0), or that the
nodes of P2 do not see (P2P0), have B^T p close to zero, the closer the finer the mesh. The sparse

.. math::

    \tilde S = B D^{-1} B^T + C + N, \quad D = \mathrm{diag}(H),

has the same small eigenvalues: B^T p is then a load of short wavelength, for which H is close to
a multiple of D. For smooth p, :math:`B D^{-1} B^T` is too small. N corrects it: the mass matrix of
the mean pressure around each node, which vanishes for alternating pressures.
"""

from __future__ import annotations

from collections.abc import Mapping

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import aij_blocks, nonzero_state
from fem_snh.linalg.block_matrix import Submatrix
from fem_snh.problem.mixed.pressure_masses import PressureMasses

#: The row sums of N over the row sums of :math:`B H^{-1} B^T` for plane waves
#: (docs/results/elements_cell_pressures.md).
_SCALE = 0.75
#: Mean change of ln D from which S is computed again. With 0.1 the linear solves take as many
#: iterations as with 0, and every third `update` computes S
#: (docs/results/elements_cell_pressures.md).
_CHANGE = 0.1


class CellSchur:
    """The approximation of the Schur complement, as a negative definite matrix. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        The matrix of displacement and pressure. The constructor reads its pattern only.
    index_sets : dict of PETSc.IS
        {"u": IS, "p": IS}, the global dofs of each field.
    masses : PressureMasses

    Attributes
    ----------
    matrix : PETSc.Mat
        The approximation, (pressures, pressures); before the first `update`, of N and a lumped mass
        matrix.
    """

    def __init__(
        self, A: PETSc.Mat, index_sets: Mapping[str, PETSc.IS], masses: PressureMasses
    ) -> None:
        self._sets = index_sets
        self._D: np.ndarray | None = None  # that of the present approximation
        self._sums = _SCALE * masses.shear_compliance.diagonal / (2 + masses.lambda_over_mu)
        self._set_pattern(A)
        self.matrix = self._N.copy()
        self._add_to_diagonal(self._sums)
        self.matrix.scale(-1.0)

    def begin_step(self) -> None:
        """Make the next `update` unconditional, so that a step does not depend on earlier steps."""
        self._D = None

    def update(self, A: PETSc.Mat) -> None:
        """Compute the approximation for ``A`` if its diagonal or pattern changed. Collective."""
        if self._B.pattern != nonzero_state(A):
            self._set_pattern(A)  # the pressures' part is the same
            self._D = None
        diagonal = A.getDiagonal().array
        num_u = self._B_transposed.matrix.getLocalSize()[0]
        D = np.abs(diagonal[:num_u])
        if self._D is not None and _change(A.comm.tompi4py(), self._D, D) < _CHANGE:
            return
        self._D = D
        B, B_transposed = self._B.matrix, self._B_transposed.matrix
        for block in (self._B, self._B_transposed):
            block.update(A)
        inverse = B_transposed.createVecLeft()
        inverse.array[:] = 1 / D
        B_transposed.diagonalScale(L=inverse)
        B.matMult(B_transposed, result=self._product)
        same = PETSc.Mat.Structure.SAME_NONZERO_PATTERN
        self._product.copy(self.matrix, same)
        self.matrix.axpy(1.0, self._N, same)
        self._add_to_diagonal(-diagonal[num_u:])  # the block of the pressures is -C
        self.matrix.scale(-1.0)

    def _add_to_diagonal(self, values: np.ndarray) -> None:
        diagonal = self.matrix.createVecLeft()
        diagonal.array[:] = values
        self.matrix.setDiagonal(diagonal, addv=PETSc.InsertMode.ADD)

    def _set_pattern(self, A: PETSc.Mat) -> None:
        """Create N, and the submatrices B and B^T of ``A`` with the pattern of their product."""
        self._B, self._B_transposed = (
            Submatrix(A, self._sets, *fields) for fields in (("p", "u"), ("u", "p"))
        )
        # A pressure's mean around a node is the mean over the cells that have the node.
        mean, mean_transposed = self._B.matrix, self._B_transposed.matrix
        for matrix in (mean, mean_transposed):
            with aij_blocks(matrix) as blocks:
                for block in blocks:
                    block.array()[:] = 1.0
        cells_of_nodes, ones = mean_transposed.createVecLeft(), mean_transposed.createVecRight()
        ones.set(1.0)
        mean_transposed.mult(ones, cells_of_nodes)
        cells_of_nodes.reciprocal()
        mean_transposed.diagonalScale(L=cells_of_nodes)
        self._N = mean.matMult(mean_transposed)
        sums = self._N.createVecLeft()
        self._N.mult(ones, sums)
        sums.array[:] = np.sqrt(self._sums / sums.array_r)
        self._N.diagonalScale(sums, sums)
        self._product = mean.matMult(mean_transposed)


def _change(comm: MPI.Intracomm, before: np.ndarray, after: np.ndarray) -> float:
    """Return the mean of ``|ln(after/before)|`` on all ranks; NaN or infinity for zeros."""
    with np.errstate(divide="ignore", invalid="ignore"):
        total = np.abs(np.log(after / before)).sum()
    total, count = comm.allreduce(np.array([total, len(after)]))
    return float(total / count)
