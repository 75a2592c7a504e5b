"""Faults of linear solvers and NaN in the solution, in the middle of a run."""

from __future__ import annotations

import signal
from pathlib import Path

from benchmarks import Row
from benchmarks.faults.intervention import CONVERGED_STEPS
from benchmarks.faults.trial import Trial, compare_with_undisturbed, resume_and_compare
from fem_snh.studies.points import read_record


def _run_first_steps(trial: Trial, ranks: int) -> None:
    """Run until `CONVERGED_STEPS` have converged, then stop the run."""
    child = trial.start_paused(ranks)
    child.process.send_signal(signal.SIGTERM)
    trial.wait(child)


def indefinite_preconditioner(folder: Path) -> Row:
    """Smooth multigrid by a Chebyshev polynomial for eigenvalues that the matrix does not have.

    With a line search: the trust region has a linear solver of its own, and the run converges.
    """
    trial = Trial(folder)
    _run_first_steps(trial, 1)
    smoother = "-mg_levels_ksp_type chebyshev -mg_levels_ksp_chebyshev_eigenvalues 0.01,0.02"
    options = f"-pc_type gamg {smoother} -snes_globalization linesearch"
    code = trial.wait(trial.start(1, *options.split(), resume=True))
    return resume_and_compare(trial, code, "DIVERGED_INDEFINITE_PC", CONVERGED_STEPS, 1)


def stagnating_solve(folder: Path) -> Row:
    """Allow 20 linear iterations where 50 are needed: Newton's method takes more iterations."""
    trial = Trial(folder)
    _run_first_steps(trial, 2)
    few = ("-ksp_max_it", "20", "-ksp_rtol", "1e-10")
    return compare_with_undisturbed(trial, trial.wait(trial.start(2, *few, resume=True)))


def diverging_solve(folder: Path) -> Row:
    """Replace conjugate gradients by Richardson's iteration, which diverges here."""
    trial = Trial(folder)
    _run_first_steps(trial, 1)
    code = trial.wait(trial.start(1, "-ksp_type", "richardson", resume=True))
    return resume_and_compare(trial, code, "DIVERGED_DTOL", CONVERGED_STEPS, 2)


def factors_out_of_memory(folder: Path) -> Row:
    """Give a direct solver one megabyte, less than its factors need."""
    trial = Trial(folder)
    _run_first_steps(trial, 2)
    solver = "-pc_type cholesky -pc_factor_mat_solver_type mumps -mat_mumps_icntl_23 1"
    code = trial.wait(trial.start(2, *solver.split(), resume=True))
    return resume_and_compare(trial, code, "do not fit into memory", CONVERGED_STEPS, 1)


def nan_in_u(folder: Path) -> Row:
    """Write NaN into the solution: the step is halved and the run continues."""
    trial = Trial(folder)
    child = trial.start(2, module="benchmarks.faults.inject_nan")
    row = compare_with_undisturbed(trial, trial.wait(child))
    steps = read_record(trial.out).get("steps", [])
    failed = [(number, s["reason"]) for number, s in enumerate(steps, 1) if not s["converged"]]
    row["status"] = "; ".join([*(reason for _, reason in failed), str(row["status"])])
    one_failed = [number for number, _ in failed] == [CONVERGED_STEPS + 1]
    row["ok"] &= one_failed and "NaN" in row["status"]
    return row
