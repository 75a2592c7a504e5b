"""Solves that go wrong in the middle of a run, and end it or not."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

from fem_snh.studies.extremes.faults.disturbed import DONE
from fem_snh.studies.extremes.faults.trial import Trial, ended, verdict
from fem_snh.studies.table import read_record

_INJECTING = "fem_snh.studies.extremes.faults.injecting"


def _begun(trial: Trial, ranks: int) -> None:
    """A run that has been stopped after some steps."""
    child = trial.held(ranks)
    child.signal(signal.SIGTERM)
    trial.wait(child)


def indefinite_preconditioner(folder: Path) -> dict[str, Any]:
    """Multigrid that smooths by a polynomial for eigenvalues which the matrix has not."""
    trial = Trial(folder)
    _begun(trial, 1)
    smoother = "-mg_levels_ksp_type chebyshev -mg_levels_ksp_chebyshev_eigenvalues 0.01,0.02"
    code = trial.wait(trial.start(1, "-pc_type", "gamg", *smoother.split(), resume=True))
    return verdict(trial, code, "DIVERGED_INDEFINITE_PC", DONE, 1)


def stagnating_solve(folder: Path) -> dict[str, Any]:
    """Twenty linear iterations where fifty are needed: Newton's method takes more steps."""
    trial = Trial(folder)
    _begun(trial, 2)
    few = ("-ksp_max_it", "20", "-ksp_rtol", "1e-10")
    return ended(trial, trial.wait(trial.start(2, *few, resume=True)))


def diverging_solve(folder: Path) -> dict[str, Any]:
    """Richardson's iteration, which diverges here, in place of conjugate gradients."""
    trial = Trial(folder)
    _begun(trial, 1)
    code = trial.wait(trial.start(1, "-ksp_type", "richardson", resume=True))
    return verdict(trial, code, "DIVERGED_DTOL", DONE, 2)


def factors_out_of_memory(folder: Path) -> dict[str, Any]:
    """A direct solver that may take one megabyte: less than its factors."""
    trial = Trial(folder)
    _begun(trial, 2)
    solver = "-pc_type cholesky -pc_factor_mat_solver_type mumps -mat_mumps_icntl_23 1"
    code = trial.wait(trial.start(2, *solver.split(), resume=True))
    return verdict(trial, code, "do not fit into memory", DONE, 1)


def nan_in_u(folder: Path) -> dict[str, Any]:
    """One number of u becomes NaN in a Newton iteration: the step is halved, the run goes on."""
    trial = Trial(folder)
    row = ended(trial, trial.wait(trial.start(2, module=_INJECTING)))
    steps = read_record(trial.out).get("steps", [])
    failed = [(number, s["reason"]) for number, s in enumerate(steps, 1) if not s["converged"]]
    row["status"] = "; ".join([*(reason for _, reason in failed), str(row["status"])])
    row["holds"] &= [number for number, _ in failed] == [DONE + 1] and "NaN" in row["status"]
    return row
