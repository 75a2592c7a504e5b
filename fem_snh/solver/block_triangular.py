r"""The block-triangular preconditioner of a saddle-point problem, without copies of the blocks.

PETSc's fieldsplit copies the blocks of the assembled matrix. `BlockTriangular` applies

.. math::

    \begin{pmatrix} \tilde H & B^T \\ 0 & -\tilde S \end{pmatrix}^{-1}

(`fem_snh.solver.saddle_point`) to the same effect and copies B^T alone: `EisenstatCG`, its solver
with H, has a copy in single precision anyway.

`BlockProduct` is the matrix A of displacement and pressure, whose product with a preconditioned
vector z = (u, p) is known: flexible GMRES multiplies every such vector by A. The preconditioner
has solved :math:`H u = f_u - B^T p`, up to a residual r that conjugate gradients keep, so that

.. math:: A z = \begin{pmatrix} f_u - r \\ B u - C p \end{pmatrix}

needs no product with H, by far the largest block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import nan

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import nonzero_state
from fem_snh.linalg.block_matrix import Submatrix, part_of
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.solver.protocol import Array, SaddlePoint

_Linear = PETSc.KSP.ConvergedReason
#: Reasons after which a solve with H has no solution. After others it has an inaccurate one.
_FAILED = (
    _Linear.DIVERGED_INDEFINITE_MAT,
    _Linear.DIVERGED_INDEFINITE_PC,
    _Linear.DIVERGED_NANORINF,
)
#: Relative tolerance of solves with S for cell pressures: of the residual itself, which flexible
#: GMRES measures, as on several ranks the preconditioned one is much smaller than the error. With
#: 0.1 some take three times as many linear iterations (docs/results/elements_cell_pressures.md).
_CELL_PRESSURE_RTOL = 0.03


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

    def set_known(self, f: PETSc.Vec, z: PETSc.Vec) -> None:
        """Keep what the product with z is made of: z is the preconditioned vector f."""
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
    """A PC of type "python": the preconditioner, with `EisenstatCG` as its solver with H.

    Its two solvers read the options of the fieldsplit's, under ``-fieldsplit_u_`` and
    ``-fieldsplit_p_``.

    Parameters
    ----------
    A : Mat
        The matrix of displacement and pressure.
    saddle_point : SaddlePoint
    coordinates : (nodes, 3)
        Reference coordinates [m] of this rank's nodes.
    prefix : str
        Prefix of the PETSc options.
    rtol, max_it : float, int
        Relative tolerance of a solve with H, and iterations of a solve with a block.

    Attributes
    ----------
    indefinite : bool
        Whether a solve with H since the last set-up found it indefinite.
    operator : Mat
        The matrix of `BlockProduct`: the operator of the outer solver.
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
        """Read the matrix's values; PETSc calls this."""
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
