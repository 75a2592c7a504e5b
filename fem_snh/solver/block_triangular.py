r"""The block-triangular preconditioner of a saddle-point problem, without copies of the blocks.

PETSc's fieldsplit copies the blocks of the assembled matrix. `BlockTriangular` applies

.. math::

    \begin{pmatrix} \tilde H & B^T \\ 0 & -\tilde S \end{pmatrix}^{-1}

(`fem_snh.solver.saddle_point`) to the same effect and copies B^T alone: `EisenstatCG`, its solver
with H, has a copy in single precision anyway.
"""

from __future__ import annotations

from math import nan

from petsc4py import PETSc

import numpy as np

from fem_snh.linalg.displacement_blocks import part_of
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.solver.block_product import BlockProduct
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

    @property
    def is_current(self) -> bool:
        """Whether the preconditioner is that of the matrix's present values."""
        return self._blocks.is_current

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

    def apply_to_columns(self, x: Array) -> tuple[Array, Array]:
        """Return y = P^-1 x of several vectors, and the products A y. Collective.

        The products are exact to single precision; all are NaN if H is indefinite.

        Parameters
        ----------
        x : (columns, rows)
            This rank's rows of the vectors.
        """
        n, (f, u, g, p) = self._unknowns, self._vectors
        y, product, rhs = np.empty_like(x), np.empty_like(x), x[:, :n].copy()
        for k, column in enumerate(x):
            g.array[:] = column[n:]
            self.p.solve(g, p)
            y[k, n:] = p.array_r
            self._blocks.B_transposed.mult(p, f)
            rhs[k] -= f.array_r
        rtol, _, _, max_it = self.u.getTolerances()
        y[:, :n], residual, indefinite = self._cg.solve_columns(rhs, rtol, max_it)
        self.indefinite |= indefinite
        product[:, :n] = x[:, :n] - residual
        for k, column in enumerate(y):
            u.array[:], p.array[:] = column[:n], column[n:]
            product[k, n:] = self._blocks.product_of_pressures(u, p)
        if self.indefinite:
            y[:] = nan
        return y, product

    def destroy(self, pc: PETSc.PC) -> None:
        """Destroy what the preconditioner created; PETSc calls this."""
        for created in (self.u, self.p, self._H, self.operator, *self._vectors):
            created.destroy()

    def view(self, pc: PETSc.PC, viewer: PETSc.Viewer) -> None:
        """Print the solvers of the blocks, as part of ``-snes_view``."""
        viewer.printfASCII("  block-triangular, with the solvers of the blocks\n")
        for solver in (self.u, self.p):
            solver.view(viewer)
