r"""The matrix of displacement and pressure, whose product with a preconditioned vector is known.

Flexible GMRES multiplies every preconditioned vector z = (u, p) by the matrix A. The preconditioner
has solved :math:`H u = f_u - B^T p`, up to a residual r that conjugate gradients keep, so that

.. math:: A z = \begin{pmatrix} f_u - r \\ B u - C p \end{pmatrix}

needs no product with H, by far the largest block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import nonzero_state
from fem_snh.linalg.matrix_parts import Submatrix
from fem_snh.solver.protocol import Array


class BlockProduct:
    """The context of a Mat of type "python" for a matrix A of displacement and pressure.

    Its product with the last preconditioned vector is exact to single precision; others are those
    of A.

    Parameters
    ----------
    A : Mat
        The matrix, symmetric; its values are read by `update`.
    index_sets : dict of PETSc.IS
        {"u": IS, "p": IS}, the unknowns of each field.
    residual : callable
        Returns r, this rank's residual of the preconditioner's last solve with H.
    """

    def __init__(
        self,
        A: PETSc.Mat,
        index_sets: Mapping[str, PETSc.IS],
        residual: Callable[[], Array],
    ) -> None:
        self._A, self._sets, self._residual = A, index_sets, residual
        self._unknowns = index_sets["u"].getLocalSize()
        self._parts: list[Submatrix] = []
        self._state = -1  # of A at the last `update`
        self._known: tuple[int, ...] = ()  # the vector
        self._f = np.empty(0)

    def update(self) -> None:
        """Read the values of A. Collective."""
        A, sets = self._A, self._sets
        if not self._parts or self._parts[0].pattern != nonzero_state(A):
            self._parts = [Submatrix(A, sets, fields, "p") for fields in "up"]
            C = self._parts[1].matrix
            self._vectors = self.B_transposed.createVecLeft(), *C.createVecs()
        for part in self._parts:
            part.update(A)
        self._state, self._known = A.stateGet(), ()

    @property
    def B_transposed(self) -> PETSc.Mat:
        """Return the block B^T."""
        return self._parts[0].matrix

    @property
    def is_current(self) -> bool:
        """Whether A has the values that were read."""
        return bool(self._A.stateGet() == self._state)

    def set_known(self, f: PETSc.Vec, z: PETSc.Vec) -> None:
        """Keep what the product with z is made of: z is the preconditioned vector f."""
        self._f = f.array_r[: self._unknowns].copy()
        self._known = z.handle, z.stateGet()

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = A x; PETSc calls this."""
        # The preconditioner may be that of a filtered Hessian, while A is the exact one.
        if (x.handle, x.stateGet()) != self._known or not self.is_current:
            self._A.mult(x, y)
            return
        n, (u, p, _) = self._unknowns, self._vectors
        u.array[:], p.array[:] = x.array_r[:n], x.array_r[n:]
        y.array[n:] = self.product_of_pressures(u, p)
        y.array[:n] = self._f - self._residual()

    def product_of_pressures(self, u: PETSc.Vec, p: PETSc.Vec) -> Array:
        """Return the pressures' rows of the product with (u, p), B u - C p. Collective."""
        q, (B_transposed, C) = self._vectors[2], self._parts
        C.matrix.mult(p, q)  # as A has it: with a minus
        B_transposed.matrix.multTransposeAdd(u, q, q)
        return q.array_r

    def destroy(self, mat: PETSc.Mat) -> None:
        """Destroy the copies of the blocks; PETSc calls this."""
        for part in self._parts:
            part.matrix.destroy()
