"""Saddle-point problems (Taylor-Hood elements): block preconditioner and merit function."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh.solver.line_search import LineSearch
from fem_snh.solver.protocol import Array, SaddlePoint
from fem_snh.solver.step import State, Step

#: Defaults of the blocks' PETSc options. BoomerAMG's smoothers converge for every positive definite
#: matrix. GAMG's polynomial smoother needs an estimate of the largest eigenvalue; where it is too
#: low, the preconditioner is indefinite.
BLOCK_OPTIONS = {
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_u_pc_type": "hypre",
    "fieldsplit_u_pc_hypre_boomeramg_strong_threshold": "0.7",
    "fieldsplit_p_ksp_type": "preonly",
    "fieldsplit_p_pc_type": "bjacobi",
}
#: Iterations of MINRES after which its approximate solution is used as a search direction.
MAX_IT = 500


def configure(ksp: PETSc.KSP, A: PETSc.Mat, saddle_point: SaddlePoint) -> None:
    """Make ``ksp`` MINRES with a block-diagonal PETSc fieldsplit. Collective.

    The block "u" is the filtered Hessian. The block "p" replaces the Schur complement
    -(B H^-1 B^T + C) by the pressure's mass matrix divided by the moduli: by the inf-sup condition
    the two are spectrally equivalent, with bounds that depend neither on nu nor on the mesh
    (Elman, Silvester & Wathen 2014, section 4.2).
    """
    ksp.setType(PETSc.KSP.Type.MINRES)
    ksp.setTolerances(max_it=MAX_IT)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.FIELDSPLIT)
    pc.setFieldSplitIS(*saddle_point.index_sets.items())
    pc.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
    pc.setFieldSplitSchurFactType(PETSc.PC.SchurFactType.DIAG)
    pc.setFieldSplitSchurPreType(PETSc.PC.SchurPreType.USER, saddle_point.schur_approximation)
    ksp.setOperators(A)


@contextmanager
def frozen_preconditioner(ksp: PETSc.KSP, A: PETSc.Mat, P: PETSc.Mat) -> Iterator[None]:
    """Set up the preconditioner of A and keep it within a ``with`` block. Collective."""
    ksp.setOperators(A, P)
    ksp.setUp()
    ksp.getPC().setReusePreconditioner(True)
    try:
        yield
    finally:
        ksp.getPC().setReusePreconditioner(False)


class MeritLineSearch(LineSearch):
    r"""A line search for a saddle-point problem: a minimum in u and a maximum in p.

    The merit function is the augmented Lagrangian [J]

    .. math:: L(u, p) + \frac{\gamma}{2} \sum_a w_a r_a^2,

    r the residual of the volume condition, 1/w_a each pressure's share of the volume. With H
    positive definite a Newton direction descends once the penalty is large enough; it is raised
    where it is not (Nocedal & Wright 2006, section 18.4, for constrained problems).

    Attributes
    ----------
    penalty : float
        The penalty gamma [Pa].
    """

    def __init__(self, saddle_point: SaddlePoint, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self.saddle_point, self.penalty = saddle_point, 0.0

    def slope(self, f: PETSc.Vec, d: PETSc.Vec, Ad: PETSc.Vec) -> float | None:
        """Return the merit function's slope along d, at most -(du.H du + dp.C dp)/2.

        The penalty is raised where descent requires it. Returns None if no penalty gives descent.
        """
        volume = self._pressures(f)
        local = np.array(
            [self._pressures(d) @ self._pressures(Ad), self._weight(volume) @ self._pressures(Ad)]
        )
        pressure_curvature, penalty_slope = f.comm.tompi4py().allreduce(local)
        curvature, energy_slope = Ad.dot(d) - 2 * pressure_curvature, f.dot(d)
        if not curvature > 0:
            return None
        excess = energy_slope + curvature / 2
        if excess + self.penalty * penalty_slope > 0:
            if penalty_slope >= 0:
                return None
            self.penalty = -2 * excess / penalty_slope
        return float(energy_slope + self.penalty * penalty_slope)

    def search(self, start: State, d: PETSc.Vec, slope: float, trial: State) -> Step:
        """Search from ``start`` along ``d``, where the merit function has this slope.

        The step found ends in ``trial``, whose vectors are overwritten in any case.
        """
        norm = start.residual.norm()
        step = first = self.largest_step(start.x, d)
        merit = start.energy + self.penalty / 2 * self._weighted_square(start.residual)
        while step >= self.min_step:
            trial_energy = self.evaluate_energy(start.x, d, step, trial)
            self.evaluate_residual(trial)
            change = trial_energy + self.penalty / 2 * self._weighted_square(trial.residual) - merit
            if not isfinite(change):
                step *= 0.5
                continue
            decreases = change <= self.armijo * step * slope
            rounding = self.is_rounding(change, merit)
            if decreases or (rounding and trial.residual.norm() <= norm):
                return Step(trial, step, step == first < 1)
            step = self._shortened(step, change, slope)
        return Step()

    def _pressures(self, vector: PETSc.Vec) -> Array:
        """Return a view of the owned pressures in a vector."""
        return self.saddle_point.pressure_dofs(vector)

    def _weight(self, volume: Array) -> Array:
        """Return w_a r_a, the residual of the volume condition over each pressure's volume."""
        return self.saddle_point.inverse_lumped_mass * volume

    def _weighted_square(self, f: PETSc.Vec) -> float:
        """Return the weighted square of the volume condition's residual, over all ranks."""
        volume = self._pressures(f)
        return float(f.comm.tompi4py().allreduce(self._weight(volume) @ volume))
