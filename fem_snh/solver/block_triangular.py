r"""The block-triangular preconditioner of a saddle-point problem, without a copy of the block H.

PETSc's fieldsplit copies all blocks of the assembled matrix. `BlockTriangular` applies the same
preconditioner (`fem_snh.solver.saddle_point`),

.. math::

    P^{-1} = \begin{pmatrix} \tilde H & B^T \\ 0 & -\tilde S \end{pmatrix}^{-1},

without copying H, of which `EisenstatCG`, its solver with H, has a single-precision copy anyway.

`BlockProduct` is the matrix A of displacement and pressure, with the displacement's block H.
Flexible GMRES multiplies A by :math:`z = P^{-1} f = (u, p)`, which the preconditioner has just made
by solving :math:`H u = f_u - B^T p` up to a residual r. Conjugate gradients keep r, so that

.. math:: A z = \begin{pmatrix} f_u - r \\ B u - C p \end{pmatrix}

needs no product with H, by far the largest block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import nan

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import nonzero_state
from fem_snh.arrays import Array
from fem_snh.linalg.block_matrix import Submatrix, part_of
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.solver.protocol import SaddlePoint

_Linear = PETSc.KSP.ConvergedReason
#: Reasons after which a solve with H has no solution; after other failures it is only inaccurate.
_FAILED = (
    _Linear.DIVERGED_INDEFINITE_MAT,
    _Linear.DIVERGED_INDEFINITE_PC,
    _Linear.DIVERGED_NANORINF,
)
#: Relative tolerance of solves with S for cell pressures, measured by flexible GMRES without a
#: preconditioner: on several ranks the preconditioned residual is much smaller than the error. With
#: 0.1 some outer solves take three times as many linear iterations
#: (docs/results/elements_cell_pressures.md).
_CELL_PRESSURE_RTOL = 0.03


class BlockProduct:
    """The context of a Mat of type "python" that multiplies A without its displacement block H.

    The product with the vector z of `set_known`, which the preconditioner has just made, is
    accurate to single precision. Other vectors are multiplied by A itself.

    Parameters
    ----------
    A : Mat
        The matrix of displacement and pressure, symmetric.
    index_sets : dict of PETSc.IS
        {"u": IS, "p": IS}, the global indices of each field.
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
        """Copy the blocks B^T and -C of A; forget the known product. Collective."""
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

    def set_known(self, f: PETSc.Vec, z: PETSc.Vec) -> None:
        """Let `mult` use that ``z`` is P^-1 ``f``, until ``z`` or A changes."""
        self._f = f.array_r[: self._unknowns].copy()
        self._known = z.handle, z.stateGet()

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = A x; PETSc calls this."""
        # The preconditioner may be that of a filtered Hessian, while A is the exact one.
        if (x.handle, x.stateGet()) != self._known or self._A.stateGet() != self._state:
            self._A.mult(x, y)
            return
        n, (u, p, _) = self._unknowns, self._vectors
        u.array[:], p.array[:] = x.array_r[:n], x.array_r[n:]
        q, (B_transposed, C) = self._vectors[2], self._parts
        C.matrix.mult(p, q)  # as A has it: with a minus
        B_transposed.matrix.multTransposeAdd(u, q, q)
        y.array[n:] = q.array_r
        y.array[:n] = self._f - self._residual()

    def destroy(self, mat: PETSc.Mat) -> None:
        """Destroy the copies of the blocks; PETSc calls this."""
        for part in self._parts:
            part.matrix.destroy()


class BlockTriangular:
    """The preconditioner as a PC of type "python", with `EisenstatCG` as its solver with H.

    Its solvers read the options of PETSc's fieldsplit, ``-fieldsplit_u_*`` and ``-fieldsplit_p_*``.

    Parameters
    ----------
    A : Mat
        The matrix of displacement and pressure.
    saddle_point : SaddlePoint
    coordinates : (nodes, dim)
        Reference coordinates [m] of this rank's nodes.
    prefix : str
        Prefix of the PETSc options.
    rtol : float
        Relative tolerance of a solve with H.
    max_it : int
        Largest number of iterations of a solve with H or S.

    Attributes
    ----------
    indefinite : bool
        Whether a solve with H since the last set-up found H indefinite, or overflowed.
    operator : Mat
        The matrix of `BlockProduct`: the operator of the outer solver.
    u, p : KSP
        The solvers with H and with S.
    """

    def __init__(
        self,
        A: PETSc.Mat,
        saddle_point: SaddlePoint,
        coordinates: Array,
        prefix: str,
        rtol: float,
        max_it: int,
    ) -> None:
        components = saddle_point.index_sets["u"].getBlockSize()
        self._unknowns = components * len(coordinates)
        self._H, S = part_of(A, self._unknowns, components), saddle_point.schur_approximation
        self._cg = EisenstatCG(coordinates)
        self._blocks = BlockProduct(A, saddle_point.index_sets, self._cg.residual)
        self.operator = PETSc.Mat().createPython(A.getSizes(), self._blocks, comm=A.comm)
        self.operator.setUp()
        self._vectors = *self._H.createVecs(), *S.createVecs()
        self.indefinite = False
        self.u, self.p = u, p = [PETSc.KSP().create(block.comm) for block in (self._H, S)]
        u.setOptionsPrefix(f"{prefix}fieldsplit_u_")
        u.setOperators(self._H)
        u.setTolerances(rtol=rtol, atol=0.0, max_it=max_it)
        u.setType(PETSc.KSP.Type.PYTHON)
        u.setPythonContext(self._cg)
        u.getPC().setType(PETSc.PC.Type.NONE)
        p.setOptionsPrefix(f"{prefix}fieldsplit_p_")
        p.setOperators(S)
        p.setType(PETSc.KSP.Type.PREONLY)
        if saddle_point.cell_pressures:  # the condition of S grows as the mesh is refined
            p.setType(PETSc.KSP.Type.FGMRES)
            p.setTolerances(rtol=_CELL_PRESSURE_RTOL, atol=0.0, max_it=max_it)
        p.getPC().setType(PETSc.PC.Type.BJACOBI)
        for solver in (u, p):
            solver.setFromOptions()

    def setUp(self, pc: PETSc.PC) -> None:
        """Read the values of the matrix and reset `indefinite`; PETSc calls this."""
        self._blocks.update()
        self._H.stateIncrease()
        self._cg.update_matrix(self._H)
        self.p.setUp()
        self.indefinite = False

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = P^-1 x, or NaN if H is indefinite; PETSc calls this."""
        n, (f, u, g, p) = self._unknowns, self._vectors
        g.array[:] = x.array_r[n:]
        self.p.solve(g, p)
        self._blocks.B_transposed.mult(p, f)
        f.array[:] = x.array_r[:n] - f.array_r
        self.u.solve(f, u)
        self.indefinite |= self.u.getConvergedReason() in _FAILED
        y.array[:n], y.array[n:] = u.array_r, p.array_r
        if self.indefinite:
            y.set(nan)
        elif self._cg.has_residual:
            self._blocks.set_known(x, y)

    def destroy(self, pc: PETSc.PC) -> None:
        """Destroy what the preconditioner created; PETSc calls this."""
        for created in (self.u, self.p, self._H, self.operator, *self._vectors):
            created.destroy()

    def view(self, pc: PETSc.PC, viewer: PETSc.Viewer) -> None:
        """Print the solvers of the blocks, as part of ``-snes_view``."""
        viewer.printfASCII("  block-triangular, with the solvers of the blocks\n")
        for solver in (self.u, self.p):
            solver.view(viewer)
