"""Converged and diverged reasons of a solve, by PETSc's names."""

from __future__ import annotations

from math import isfinite
from typing import Any

from petsc4py import PETSc

from fem_snh._petsc import factors_out_of_memory
from fem_snh.solver.step import Direction


def converged_reason(snes: PETSc.SNES) -> str:
    """Return PETSc's name for the end of the last solve: "CONVERGED_FNORM_ABS", ..."""
    return _name(PETSc.SNES.ConvergedReason, snes.getConvergedReason())


def failure_reason(snes: PETSc.SNES) -> str:
    """Return `converged_reason`, followed by its cause if the last solve failed. Collective.

    For example "DIVERGED_LINEAR_SOLVE: DIVERGED_INDEFINITE_PC".
    """
    reason = converged_reason(snes)
    if snes.getConvergedReason() < 0 and not isfinite(snes.getSolution().norm()):
        return f"{reason}: NaN or infinity in the unknowns"
    if snes.getConvergedReason() != PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
        return reason
    return linear_failure(snes.getKSP())


def linear_failure(ksp: PETSc.KSP, direction: Direction | None = None) -> str:
    """Return the reason of a step without a direction: "DIVERGED_LINEAR_SOLVE: " and its cause."""
    reason, linear = "DIVERGED_LINEAR_SOLVE", ksp.getConvergedReason()
    if factors_out_of_memory(ksp.getPC()):
        return f"{reason}: the factors do not fit into memory"
    if direction and direction.lack:
        factors = "; sparse factors do not fit into memory" if direction.out_of_memory else ""
        return f"{reason}: {direction.lack}{factors}"
    if linear >= 0:
        return f"{reason}: no descent direction"
    return f"{reason}: {_name(PETSc.KSP.ConvergedReason, linear)}"


def out_of_memory(snes: PETSc.SNES) -> bool:
    """Return whether the last solve failed because the factors did not fit into memory."""
    failed = snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
    return failed and factors_out_of_memory(snes.getKSP().getPC())


def _name(reasons: Any, code: int) -> str:
    """Return PETSc's name of a reason."""
    names = {v: k for k, v in vars(reasons).items() if isinstance(v, int)}
    return names.get(code, str(code))
