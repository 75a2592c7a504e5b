"""Saddle-point problems (Taylor-Hood elements): block preconditioner and merit function."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Literal

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import set_operators
from fem_snh.arrays import Array
from fem_snh.solver.block_triangular import BlockTriangular
from fem_snh.solver.protocol import SaddlePoint, SolvableProblem
from fem_snh.solver.step import ARMIJO, MIN_STEP, LineSearch, State, Step

#: A preconditioner by blocks; "fieldsplit" is PETSc's.
Blocks = BlockTriangular | Literal["fieldsplit"]
#: Iterations after which the approximate solution is used as a search direction. A solve takes 3 to
#: 12 (docs/results/elements_taylor_hood.md); MINRES with its diagonal preconditioner up to 30.
MAX_IT = 100
#: Relative tolerance of the inner solves with the block "u". A smaller one saves fewer outer
#: iterations than it costs inner ones (docs/results/elements_taylor_hood.md).
INNER_RTOL = 0.1
#: Largest number of iterations of an inner solve: about 4 suffice for a definite block.
_INNER_MAX_IT = 50
#: Least relative tolerance with `BlockProduct`, whose products are accurate to single precision.
_KNOWN_PRODUCT_RTOL = 1e-3
#: Outer solvers that admit a preconditioner which differs from one application to the next.
_FLEXIBLE = ("fgmres", "gcr")
#: Outer solvers that require a symmetric positive definite preconditioner.
_SYMMETRIC = ("minres", "symmlq")
#: Options of a fieldsplit's blocks. BoomerAMG's smoothers converge for every positive definite
#: matrix. GAMG's polynomial smoother needs an estimate of the largest eigenvalue; where it is too
#: low, the preconditioner is indefinite.
_BLOCK_OPTIONS = {
    "fieldsplit_p_ksp_type": "preonly",
    "fieldsplit_p_pc_type": "bjacobi",
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_u_pc_type": "hypre",
    "fieldsplit_u_pc_hypre_boomeramg_strong_threshold": "0.7",
}


def configure(
    ksp: PETSc.KSP, A: PETSc.Mat, saddle_point: SaddlePoint, coordinates: Array, prefix: str = ""
) -> None:
    r"""Make ``ksp`` flexible GMRES with a block-triangular preconditioner. Collective.

    The preconditioner is

    .. math::

        \begin{pmatrix} \tilde H & B^T \\ 0 & -\tilde S \end{pmatrix}^{-1} .

    The block "u" is the Hessian, filtered where it is indefinite; `EisenstatCG` solves with it to
    the relative tolerance `INNER_RTOL`. The block "p" approximates the Schur complement
    -(B H^-1 B^T + C) by the pressure's mass matrix divided by the moduli: by the inf-sup condition
    the two are spectrally equivalent, with bounds that depend neither on nu nor on the mesh
    (Elman, Silvester & Wathen 2014, section 4.2). With exact blocks the preconditioned matrix has
    the eigenvalue 1 and those of :math:`\tilde S^{-1} S`, which are positive (Benzi, Golub & Liesen
    2005, section 10.1.2).

    Where an option sets another solver or preconditioner for the block "u", the preconditioner is
    PETSc's fieldsplit; also where the outer solver requires the same preconditioner in every
    iteration. With the option ``ksp_type minres`` it is block-diagonal and positive definite.

    Parameters
    ----------
    ksp : KSP
    A : Mat
        The matrix of displacement and pressure.
    saddle_point : SaddlePoint
    coordinates : (rows, dim)
        Reference coordinates [m] of this rank's nodes.
    prefix : str
        Prefix of the PETSc options.
    """
    ksp.setType(PETSc.KSP.Type.FGMRES)
    ksp.setTolerances(max_it=MAX_IT)
    ksp.setGMRESRestart(MAX_IT)  # with PETSc's 30, solves with cell pressures take up to twice
    set_operators(ksp, A, A)
    pc = ksp.getPC()
    if _has_inner_iteration(prefix):
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(
            BlockTriangular(A, saddle_point, coordinates, prefix, INNER_RTOL, _INNER_MAX_IT)
        )
        return
    pc.setType(PETSc.PC.Type.FIELDSPLIT)
    pc.setFieldSplitIS(*saddle_point.index_sets.items())
    pc.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
    kinds = PETSc.PC.SchurFactType
    diagonal = _outer_solver(prefix) in _SYMMETRIC
    pc.setFieldSplitSchurFactType(kinds.DIAG if diagonal else kinds.UPPER)
    pc.setFieldSplitSchurPreType(PETSc.PC.SchurPreType.USER, saddle_point.schur_approximation)


def outer_operator(ksp: PETSc.KSP, A: PETSc.Mat, P: PETSc.Mat) -> PETSc.Mat:
    """Return the operator for a solve of ``ksp`` with A: a Mat of `BlockProduct`, or A itself.

    A `BlockProduct` requires a `BlockTriangular` preconditioner, made of P = A, and a relative
    tolerance of ``ksp`` of at least 1e-3.
    """
    blocks = preconditioner_by_blocks(ksp.getPC())
    loose = ksp.getTolerances()[0] >= _KNOWN_PRODUCT_RTOL
    return blocks.operator if isinstance(blocks, BlockTriangular) and A == P and loose else A


def block_options(prefix: str) -> dict[str, str]:
    """Return default options of a fieldsplit's blocks; none if `BlockTriangular` is used."""
    return {} if _has_inner_iteration(prefix) else _BLOCK_OPTIONS


def preconditioner_by_blocks(pc: PETSc.PC) -> Blocks | None:
    """Return the `BlockTriangular` of a PC, "fieldsplit" for PETSc's, or None for another PC."""
    if pc.getType() == PETSc.PC.Type.PYTHON:
        context = pc.getPythonContext()
        return context if isinstance(context, BlockTriangular) else None
    return "fieldsplit" if pc.getType() == PETSc.PC.Type.FIELDSPLIT else None


def _outer_solver(prefix: str) -> str:
    """Return the type of the outer solver that the options name, or the default."""
    return str(PETSc.Options(prefix).getString("ksp_type", PETSc.KSP.Type.FGMRES))


def _has_inner_iteration(prefix: str) -> bool:
    """Return whether the options leave the preconditioner to `BlockTriangular`."""
    options = PETSc.Options(prefix)
    names = "pc_type", "fieldsplit_u_ksp_type", "fieldsplit_u_pc_type"
    replaced = any(options.hasName(name) for name in names)
    return _outer_solver(prefix) in _FLEXIBLE and not replaced


@contextmanager
def frozen_preconditioner(
    ksp: PETSc.KSP, A: PETSc.Mat, P: PETSc.Mat, assemble: Callable[[], object] | None = None
) -> Iterator[None]:
    """Set up the preconditioner of A and keep it within a ``with`` block. Collective.

    Parameters
    ----------
    ksp : KSP
    A, P : Mat
        The operator and the matrix that the preconditioner is made of.
    assemble : callable, optional
        Assembles another operator into the same matrices after the set-up. The preconditioner is
        frozen only afterwards, as SNESComputeJacobian, which ``assemble`` may call, unfreezes it.
    """
    set_operators(ksp, A, P)
    ksp.setUp()
    if assemble is not None:
        assemble()
    ksp.getPC().setReusePreconditioner(True)
    try:
        yield
    finally:
        ksp.getPC().setReusePreconditioner(False)


class MeritLineSearch(LineSearch):
    r"""A line search on a merit function, for a minimum in u and a maximum in p.

    The merit function is the augmented Lagrangian [J]

    .. math:: L(u, p) + \frac{\gamma}{2} \sum_a w_a r_a^2,

    r_a the residual of the volume condition of pressure a, 1/w_a its entry of the lumped mass
    matrix. With H positive definite a Newton direction descends if the penalty is large enough; a
    penalty that is too small is raised (Nocedal & Wright 2006, section 18.4, for constrained
    problems).

    Attributes
    ----------
    penalty : float
        The penalty gamma [Pa], which only grows, from 0.
    """

    def __init__(self, snes: PETSc.SNES, problem: SolvableProblem) -> None:
        super().__init__(snes, problem)
        assert problem.saddle_point is not None
        self.saddle_point, self.penalty = problem.saddle_point, 0.0

    def slope(self, f: PETSc.Vec, d: PETSc.Vec, Ad: PETSc.Vec) -> float | None:
        """Return the merit function's slope along d, at most -(du.H du + dp.C dp)/2.

        The penalty is raised where descent requires it. Returns None if du.H du + dp.C dp <= 0, or
        no penalty gives descent.
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
        """Return an acceptable step, as `LineSearch.search`; ``slope`` is the merit function's."""
        norm = start.residual.norm()
        step = first = self.largest_step(start.x, d)
        merit = start.energy + self.penalty / 2 * self._weighted_square(start.residual)
        while step >= MIN_STEP:
            trial_energy = self.evaluate_energy(start.x, d, step, trial)
            self.evaluate_residual(trial)
            change = trial_energy + self.penalty / 2 * self._weighted_square(trial.residual) - merit
            if not isfinite(change):
                step *= 0.5
                continue
            decreases = change <= ARMIJO * step * slope
            rounding = self.is_rounding(change, merit)
            if decreases or (rounding and trial.residual.norm() <= norm):
                return Step(trial, step, step == first < 1)
            step = self._shortened(step, change, slope)
        return Step()

    def _pressures(self, vector: PETSc.Vec) -> Array:
        """Return a view of the pressures that this rank owns in a vector."""
        return self.saddle_point.pressure_dofs(vector)

    def _weight(self, volume: Array) -> Array:
        """Return w_a r_a for this rank's residuals r_a of the volume condition."""
        return self.saddle_point.inverse_lumped_mass * volume

    def _weighted_square(self, f: PETSc.Vec) -> float:
        """Return the sum of w_a r_a^2 of a residual ``f`` over all ranks. Collective."""
        volume = self._pressures(f)
        return float(f.comm.tompi4py().allreduce(self._weight(volume) @ volume))
