"""The SSOR preconditioner in single precision, for PETSc's own linear solvers."""

from __future__ import annotations

from math import inf

from petsc4py import PETSc

from fem_snh._petsc import nonzero_state
from fem_snh.linalg.ssor_system import SSORSystem


class SSOR:
    r"""A PC of type "python" for a symmetric AIJ matrix of 3x3 blocks. Collective.

    .. math:: M = (D + L)\, D^{-1} (D + L)^T \text{ on each rank's rows}

    `fem_snh.linalg.ssor_system` defines D and L. A product with :math:`M^{-1}` is a forward and a
    backward substitution in single precision, which read a third of what incomplete factors do.
    M is symmetric to single precision, and positive definite if the blocks of D are.
    """

    def create(self, pc: PETSc.PC) -> None:
        """Set an empty state; PETSc calls this."""
        self._pattern = (-1, (-1, -1))  # of the matrix last used
        self._system: SSORSystem

    def setUp(self, pc: PETSc.PC) -> None:
        """Copy the matrix; PETSc calls this where its values have changed."""
        P = pc.getOperators()[1]
        pattern = (P.handle, nonzero_state(P))
        if self._pattern != pattern:
            self._system, self._pattern = SSORSystem(P, None), pattern
        self._failed = bool(self._system.update(P))

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = M^-1 x; infinite values tell the KSP that M is not finite or indefinite."""
        if self._failed:
            y.set(inf)
        else:
            self._system.precondition(x, y)
