"""Saddle points: the block preconditioner of a Taylor-Hood problem, and its line search."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh.solver.line_search import LineSearch

#: PETSc options of the blocks, unless others are given. The smoothers of BoomerAMG converge for
#: every definite matrix; GAMG's polynomial one needs an estimate of the largest eigenvalue, and
#: where that is too low, the preconditioner is indefinite.
BLOCKS = {
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_u_pc_type": "hypre",
    "fieldsplit_u_pc_hypre_boomeramg_strong_threshold": "0.7",
    "fieldsplit_p_ksp_type": "preonly",
    "fieldsplit_p_pc_type": "bjacobi",
}
#: Linear iterations after which a direction is taken for what it is.
MOST = 500


def configure(ksp: PETSc.KSP, A: PETSc.Mat, saddle: Any) -> None:
    """MINRES with a block-diagonal PETSc fieldsplit, as options are free to change. Collective.

    Blocks: "u", the filtered Hessian; "p", which stands for the Schur complement -(B H^-1 B^T + C),
    the pressure's mass matrix by the moduli. By the inf-sup condition its spectrum beside that of
    the Schur complement knows neither nu nor the mesh.
    """
    ksp.setType(PETSc.KSP.Type.MINRES)
    ksp.setTolerances(max_it=MOST)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.FIELDSPLIT)
    pc.setFieldSplitIS(*saddle.index_sets.items())
    pc.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
    pc.setFieldSplitSchurFactType(PETSc.PC.SchurFactType.DIAG)
    pc.setFieldSplitSchurPreType(PETSc.PC.SchurPreType.USER, saddle.schur_approximation)
    ksp.setOperators(A)


@contextmanager
def preconditioner_of(ksp: PETSc.KSP, A: PETSc.Mat, P: PETSc.Mat) -> Iterator[None]:
    """Meanwhile the preconditioner stays that of A as it is now. Collective."""
    ksp.setOperators(A, P)
    ksp.setUp()
    ksp.getPC().setReusePreconditioner(True)
    try:
        yield
    finally:
        ksp.getPC().setReusePreconditioner(False)


@dataclass
class SaddleSearch(LineSearch):
    """Finds a step along d = (du, dp) to a saddle: down in u, up in p.

    What falls is the augmented Lagrangian L(u, p) + penalty/2 sum_a w_a r_a^2 [J], r the residual
    of the volume condition, 1/w_a each pressure's share of the volume. With H positive definite the
    direction descends once the penalty is large enough, and it is raised where it is not (Nocedal &
    Wright 2006, section 18.4, for the same with constraints).
    """

    saddle: Any = None
    penalty: float = 0.0  # [Pa]
    _square: float = 0.0
    _norm: float = 0.0

    def slope(self, f: PETSc.Vec, d: PETSc.Vec, Ad: PETSc.Vec) -> float | None:
        """The merit's slope along d, at most -(du.H du + dp.C dp)/2; None if there is none.

        Raises the penalty as needed.
        """
        gap = self._gap(f)
        mine = np.array([self._gap(d) @ self._gap(Ad), self._weigh(gap) @ self._gap(Ad)])
        both, gain = f.comm.tompi4py().allreduce(mine)
        curvature, descent = Ad.dot(d) - 2 * both, f.dot(d)
        self._square, self._norm = self._squares(f), f.norm()
        if not curvature > 0:
            return None
        excess = descent + curvature / 2
        if excess + self.penalty * gain > 0:
            if gain >= 0:
                return None
            self.penalty = -2 * excess / gain
        return descent + self.penalty * gain

    def search(
        self, x: PETSc.Vec, d: PETSc.Vec, energy: float, slope: float
    ) -> tuple[float, float] | None:
        """From ``x`` with Lagrangian ``energy`` and the merit's ``slope``: (step, energy there)."""
        step, start = 1.0, energy + self.penalty / 2 * self._square
        while step >= self.min_step:
            there = self.energy_at(x, d, step)
            self.snes.computeFunction(self.trial, self.f_trial)
            change = there + self.penalty / 2 * self._squares(self.f_trial) - start
            if not isfinite(change):
                step *= 0.5
                continue
            falls = change <= self.armijo * step * slope
            if falls or (self.flat(change, start) and self.f_trial.norm() <= self._norm):
                return step, there
            step = self._shorter(step, change, slope)
        return None

    def _gap(self, vector: PETSc.Vec) -> Any:
        return self.saddle.pressure_dofs(vector)

    def _weigh(self, gap: Any) -> Any:
        return self.saddle.inverse_lumped_mass * gap

    def _squares(self, f: PETSc.Vec) -> float:
        gap = self._gap(f)
        return float(f.comm.tompi4py().allreduce(self._weigh(gap) @ gap))
