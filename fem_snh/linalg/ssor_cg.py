"""Conjugate gradients with SSOR in single precision: the linear solver of displacements.

Newton's linear systems are solved to a digit or two, in a time that is memory traffic. Eisenstat's
form of SSOR (SIAM J. Sci. Stat. Comput. 2, 1981) preconditions for the price of the product that
conjugate gradients make anyway, and half of a symmetric matrix in single precision is a fifth of
what a product with PETSc's AIJ moves.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import aij_blocks
from fem_snh.errors import BadInput, on_root
from fem_snh.kernels import build
from fem_snh.linalg.block_matrix import Blocks, source
from fem_snh.linalg.deflation import Deflation
from fem_snh.linalg.halo import Halo

_Reason = PETSc.KSP.ConvergedReason
#: The digits that a pass in single precision is asked for; where more are wanted, there are more
#: passes, and each has to gain this.
_PASS, _GAIN = 1e-4, 0.5
#: A negative curvature this small, beside a preconditioned direction's largest, is rounding.
_FLAT = 1e-6
#: Nodes in a part of the coarse space, and how many parts pay: few leave most of the work, and each
#: adds to what all ranks solve.
_NODES, _FEWEST_PARTS, _MOST_PARTS = 512, 4, 64
_BY_SIZE = -1
#: Iterations that any matrix may take.
_FEW = 100


class EisenstatCG:
    """A KSP of type "python" for a symmetric AIJ matrix of 3x3 blocks. Collective.

    A = L + D + L^T on each rank's rows; the preconditioner is M = (D + L) D^-1 (D + L^T), and the
    norm the natural one, sqrt(r.M^-1 r). Where more digits are wanted than single precision has,
    residuals are computed anew with A itself. Tolerances, monitors and reasons are as of any KSP;
    its PC is not used.

    With the places of nodes, what is slow to converge is solved for at once, see `Deflation`.

    CONVERGED_HAPPY_BREAKDOWN where the matrix turns out to be singular,
    DIVERGED_INDEFINITE_MAT where a direction of negative curvature is met, DIVERGED_INDEFINITE_PC
    where a diagonal block is not positive definite or the sweeps overflow, DIVERGED_BREAKDOWN where
    single precision gains nothing. Raises BadInput for a matrix of other blocks.
    """

    def __init__(self, places: np.ndarray | None = None) -> None:
        """``places`` (rows, 3): where this rank's nodes are at rest, for `Deflation`, if any."""
        self._places, self._asked = places, _BY_SIZE

    def create(self, ksp: PETSc.KSP) -> None:
        self._matrix = self._state = -1
        self._blocks: Blocks

    def setFromOptions(self, ksp: PETSc.KSP) -> None:
        """Read ``ksp_deflation_subdomains``: 0 for none; by default as many as pay."""
        self._asked = PETSc.Options(ksp.getOptionsPrefix()).getInt(
            "ksp_deflation_subdomains", _BY_SIZE
        )

    @property
    def nbytes(self) -> int:
        """What this rank keeps of the matrix it last solved with, and an iteration reads twice."""
        return self._blocks.nbytes + (self._deflation.nbytes if self._deflation else 0)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Put an approximate A^-1 b into ``x``, whatever was there."""
        A = ksp.getOperators()[0]
        self.update_matrix(A)
        x.set(0.0)
        residual, its, earlier = b.copy(), 0, inf
        ksp.setConvergedReason(_Reason.CONVERGED_ITERATING)
        ksp.setIterationNumber(0)
        if self._bad:
            ksp.setConvergedReason(self._bad)
            return
        norm, unit = self._begin(residual)  # what the tolerance is relative to, deflated or not
        if not isfinite(norm):
            ksp.setConvergedReason(_Reason.DIVERGED_INDEFINITE_PC)
            return
        self._test(ksp, its, norm)
        while not ksp.getConvergedReason():
            if its or self._deflation:
                norm, unit = self._begin(residual, self._deflation)
            if norm > _GAIN * earlier:
                ksp.setConvergedReason(_Reason.DIVERGED_BREAKDOWN)
                return
            its, earlier = self._pass(ksp, its, norm, unit), norm
            if self._deflation:
                self._deflation.finish(self._pointers["x"])
            x.array[:] += unit * self._x
            if not ksp.getConvergedReason():  # another pass: its residual in double precision
                A.mult(x, residual)
                residual.aypx(-1.0, b)

    def _test(self, ksp: PETSc.KSP, its: int, norm: float) -> bool:
        """Tell the KSP where it is; whether to stop."""
        ksp.setIterationNumber(its)
        ksp.setResidualNorm(norm)
        ksp.logConvergenceHistory(norm)
        reason = ksp.callConvergenceTest(its, norm)
        # In exact arithmetic this many steps are enough; more are rounding, of a singular matrix.
        if not reason and its >= min(ksp.getTolerances()[3], max(_FEW, self._unknowns)):
            reason = _Reason.DIVERGED_MAX_IT
        ksp.setConvergedReason(reason)
        ksp.monitor(its, norm)
        return bool(reason)

    def _begin(
        self, residual: PETSc.Vec, deflation: Deflation | None = None
    ) -> tuple[float, float]:
        """Start a pass from x = 0: the residual's natural norm, and the unit of its solution."""
        size = residual.norm(PETSc.NormType.INFINITY)
        size = size if isfinite(size) and size > 0 else 1.0
        self._r[:] = residual.array_r / size
        if deflation:
            deflation.start(self._pointers["r"])
        for key in "xptq":
            self._vectors[key][:] = 0
        blocks, r = self._blocks, self._pointers["r"]
        blocks.lib.solve_lower(blocks.struct, r)
        self._rho = self._update(0.0)
        unit = size * self._scale
        return size * sqrt(self._scale * max(self._rho, 0.0)), unit

    def _pass(self, ksp: PETSc.KSP, its: int, start: float, unit: float) -> int:
        """Conjugate gradients until a test ends them, or the pass its digits; iterations so far."""
        blocks, v, beta = self._blocks, self._pointers, 0.0
        rho = first = self._rho
        if rho == 0:  # the coarse space has all of the solution
            self._test(ksp, its + 1, 0.0)
            return its + 1
        while True:
            blocks.lib.sweep_up(blocks.struct, beta, v["z"], v["p"], v["t"], v["w"])
            if self._halo:
                self._halo.exchange(self._t)
            if self._deflation:
                self._deflation.project(v["t"], v["w"])
            curvature = self._sum(
                blocks.lib.sweep_down(blocks.struct, v["p"], v["t"], v["ghosts"], v["w"], v["q"])
            )
            flat = False
            if not 0 < curvature < inf:
                floor = _FLAT * self._sum(blocks.weight(self._vectors["p"]))
                if flat := 0 <= -curvature <= floor:
                    curvature = floor
                else:
                    ksp.setConvergedReason(_negative(curvature))
                    return its
            new = self._update(rho / curvature)
            if not isfinite(new):
                ksp.setConvergedReason(_negative(new))
                return its
            its += 1
            ratio = sqrt(max(new, 0.0) / first)
            if self._test(ksp, its, start * ratio) or ratio <= _PASS:
                return its
            if flat:  # nothing more is known of a singular matrix
                ksp.setConvergedReason(_Reason.CONVERGED_HAPPY_BREAKDOWN)
                return its
            beta, rho = new / rho, new

    def _update(self, alpha: float) -> float:
        blocks, v = self._blocks, self._pointers
        return self._sum(
            blocks.lib.update(blocks.struct, alpha, v["t"], v["q"], v["x"], v["r"], v["z"])
        )

    def _sum(self, mine: float) -> float:
        return mine if self._comm.size == 1 else float(self._comm.allreduce(mine))

    def update_matrix(self, A: PETSc.Mat, force: bool = False) -> None:
        """Take the matrix's values, if new or ``force``; its pattern, if it is another matrix."""
        if self._matrix != A.handle:
            self._prepare(A)
        if self._state == A.stateGet() and not force:
            return
        self._state = A.stateGet()
        with aij_blocks(A) as (near, *far):
            largest = self._comm.allreduce(self._blocks.largest(near.values), op=MPI.MAX)
            if not isfinite(largest):
                self._bad = _Reason.DIVERGED_NANORINF
                return
            self._scale = 1 / largest if largest > 0 else 1.0
            values = near.values, far[0].values if far else 0
            bad = self._comm.allreduce(self._blocks.fill(*values, self._scale))
            self._bad = _Reason.DIVERGED_INDEFINITE_PC if bad else 0
            if self._deflation and not bad:
                self._bad = self._deflation.take(*values, self._scale)

    def _prepare(self, A: PETSc.Mat) -> None:
        if A.getBlockSize() != 3:
            raise BadInput("the solver 'eisenstat' needs 3x3 blocks, those of a displacement alone")
        self._matrix, self._state, self._comm = A.handle, -1, A.comm.tompi4py()
        self._unknowns = A.getSize()[0]
        path = on_root(self._comm, build.library, source())
        with aij_blocks(A) as (near, *far):
            patterns = near.blocks(3), far[0].blocks(3) if far else None
            self._blocks = Blocks(path, *patterns)
            nodes = far[0].ghosts[::3] // 3 if far else None
        first = A.getOwnershipRanges() // 3
        self._halo = None if nodes is None else Halo(self._comm, first, nodes)
        self._deflation = None
        parts = self._asked
        if parts == _BY_SIZE:
            parts = min(self._unknowns // (3 * _NODES), _MOST_PARTS)
            parts = parts if parts >= _FEWEST_PARTS else 0
        if self._places is not None and parts > 0:
            self._deflation = Deflation(
                self._comm, self._blocks, *patterns, self._halo, self._places, parts
            )
        names = "xrzptwq"
        vectors: list[np.ndarray] = [np.zeros(3 * self._blocks.rows, np.float32) for _ in names]
        self._x, self._r, self._t = vectors[0], vectors[1], vectors[4]
        self._vectors = dict(zip(names, vectors, strict=True))
        self._vectors["ghosts"] = self._halo.ghosts if self._halo else vectors[0]
        self._pointers = {key: self._blocks.pointer(v) for key, v in self._vectors.items()}


def _negative(curvature: float) -> int:
    """Why a solve ends that met this."""
    # Sweeps over a positive matrix cannot grow; over another they may, to infinity.
    grown = not isfinite(curvature)
    reason = _Reason.DIVERGED_INDEFINITE_PC if grown else _Reason.DIVERGED_INDEFINITE_MAT
    return int(reason)
