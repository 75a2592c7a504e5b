"""The SSOR preconditioner in single precision, for PETSc's own linear solvers."""

from __future__ import annotations

from math import inf

from petsc4py import PETSc

from fem_snh.linalg.ssor_system import SSORSystem


class SSOR:
    r"""A PC of type "python" for a symmetric AIJ matrix of 2x2 or 3x3 blocks. Collective.

    .. math:: M = (D + L)\, D^{-1} (D + L)^T \text{ on each rank's rows}

    `fem_snh.linalg.ssor_system` defines D and L. A product with :math:`M^{-1}` is a forward and a
    backward substitution in single precision, which read a third of what incomplete factors do.
    M is symmetric to single precision, and positive definite if the blocks of D are.
    """

    def create(self, pc: PETSc.PC) -> None:
        """Set an empty state; PETSc calls this."""
        self._system: SSORSystem | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Copy the matrix; PETSc calls this where its values have changed."""
        P = pc.getOperators()[1]
        if self._system is None or not self._system.fits(P):
            self._system = SSORSystem(P, None)
        self._failed = bool(self._system.update(P))

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = M^-1 x; infinite values tell the KSP that M is not finite or indefinite."""
        assert self._system is not None, "before `setUp`"
        if self._failed:
            y.set(inf)
        else:
            self._system.precondition(x, y)
