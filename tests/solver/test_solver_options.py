"""PETSc's options, monitors, views, tolerances and errors of the SNES."""

from __future__ import annotations

import subprocess
import sys
from contextlib import nullcontext

from petsc4py import PETSc

import numpy as np
import pytest
from bodies import Condition, Hold, problem, set_values
from paths import SUPPORT
from solver_problems import (
    SYMMETRIC,
    options,
    solve,
    twist,
)

from fem_snh import solver
from fem_snh._petsc import set_operators
from fem_snh.accuracy.duals import HessianSolver
from fem_snh.errors import BadInput, Range
from fem_snh.mesh import mesh
from fem_snh.solver.options import OPTIONS
from fem_snh.solver.stability import is_definite

mpi = pytest.mark.mpi


def printed(capfd, comm):
    """Return what PETSc has printed on rank 0."""
    PETSc.Sys.syncFlush(comm=comm)
    comm.barrier()
    return capfd.readouterr().out


@pytest.mark.one_debian("ranks")
@mpi
def test_monitor_and_converged_reason_print_as_petsc_does(comm, capfd):
    with options(snes_monitor=None, snes_converged_reason=None, ksp_converged_reason=None):
        snes, _ = solve(twist(comm))
    text = printed(capfd, comm)
    if comm.rank == 0:
        assert text.count("SNES Function norm") == snes.getIterationNumber() + 1
        assert "solve converged due to CONVERGED_FNORM_ABS iterations" in text
        assert text.count("Linear snh_ solve converged due to CONVERGED_RTOL") >= 2


@mpi
def test_view_shows_the_solver_and_its_options(comm, capfd):
    with options(snes_view=None, snes_armijo=0.01):
        solve(twist(comm))
    text = printed(capfd, comm)
    if comm.rank == 0:
        assert "projected Newton with a line search" in text
        for name in ("snes_hessian = adaptive", "snes_scaled_tol = 1e-07", "snes_armijo = 0.01"):
            assert f"  {name}\n" in text
        assert "fem_snh.linalg.ssor_cg.EisenstatCG" in text and "(snh_)" in text


@pytest.mark.one_debian("ranks")
@mpi
def test_python_monitors_updates_and_history(comm):
    p = twist(comm)
    snes = solver.create(p)
    snes.setConvergenceHistory()
    seen, updated = [], []
    snes.setMonitor(lambda snes, its, norm: seen.append((its, norm)))
    snes.setUpdate(lambda snes, its, found: found.append((its, len(seen))), (updated,))
    solver.Predictor(p, snes, "none").predict(1.0)
    snes.solve(None, p.x)
    norms, _ = snes.getConvergenceHistory()
    its = snes.getIterationNumber()
    assert [i for i, _ in seen] == list(range(its + 1))
    assert list(norms) == [n for _, n in seen] and len(norms) == its + 1
    assert updated == [(i, i + 1) for i in range(its)]  # once in an iteration, after the monitor
    history = snes.getPythonContext().history
    assert [i.residual for i in history] == list(norms[:-1])


@pytest.mark.one_debian
@mpi
def test_multigrid_with_the_near_null_space(comm):
    """With the rigid motions in its coarse spaces multigrid takes far fewer iterations."""
    linear = []
    for rigid in (True, False):
        p = twist(comm, cells=6)
        if not rigid:
            p.A.setNearNullSpace(PETSc.NullSpace().create(constant=True, comm=comm))
        with options(pc_type="gamg", ksp_rtol=1e-3, snes_forcing_max=0):
            snes, context = solve(p, hessian="clamp")
        assert snes.getConvergedReason() > 0
        linear.append(snes.getLinearSolveIterations() / len(context.history))
    assert linear[0] < 0.8 * linear[1]


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("its", [0, 1, 3])
def test_max_it(comm, its):
    p = twist(comm)
    with options(snes_max_it=its):
        snes, context = solve(p)
    assert solver.converged_reason(snes) == "DIVERGED_MAX_IT"
    assert snes.getIterationNumber() == len(context.history) == its
    r = p.x.duplicate()
    p.residual(p.x, r)
    assert r.norm() == pytest.approx(snes.getFunctionNorm(), rel=1e-9)


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("E", [1.0, 1e6])
def test_absolute_tolerance_is_in_newtons(comm, E):
    with options(snes_atol=1e-3 * E, snes_scaled_tol=0):
        snes, context = solve(twist(comm, E=E))
    assert solver.converged_reason(snes) == "CONVERGED_FNORM_ABS"
    assert snes.getFunctionNorm() <= 1e-3 * E < context.history[-1].residual


@pytest.mark.one_debian("ranks")
@mpi
def test_relative_tolerance(comm):
    with options(snes_rtol=1e-2, snes_scaled_tol=0):
        snes, context = solve(twist(comm))
    first = context.history[0].residual
    assert solver.converged_reason(snes) == "CONVERGED_FNORM_RELATIVE"
    assert snes.getFunctionNorm() <= 1e-2 * first < context.history[-1].residual


@mpi
def test_growing_residual_is_no_divergence(comm):
    """A column leaves its unstable straight state: the residual grows by a factor of 1e4."""

    def squeeze(X, load):
        return load * np.array([-1.8, 0, 0]) * np.ones_like(X)

    body = mesh.generate(comm, "cylinder", "hexahedron", cells=3, length=6.0, radius=0.5)
    p = problem(body, "Q1", hold=[Hold("left")], move=[Condition("right", squeeze)])
    with options(snes_scaled_tol=1e-5, **SYMMETRIC):
        snes, _ = solve(p, hessian="clamp", predictor="tangent")
    straight, energy = p.x.copy(), p.energy(p.x)
    assert snes.getConvergedReason() > 0
    bow = set_values(
        p, lambda X: 1e-5 * np.sin(np.pi * X[:, :1] / 6) ** 2 * [0, 1, 0], p.x.duplicate()
    )
    p.x.axpy(1.0, bow)
    bent = p.x.copy()
    with options(snes_max_it=25):  # clamp needs many more to converge
        snes = solver.create(p, "clamp", "linesearch")
    snes.solve(None, p.x)
    context = snes.getPythonContext()
    assert solver.converged_reason(snes) == "DIVERGED_MAX_IT"
    assert max(i.residual for i in context.history) > 1e4 * context.history[0].residual
    assert p.energy(p.x) < 0.9 * energy
    straight.axpy(-1.0, p.x)
    assert straight.norm(PETSc.NormType.INFINITY) > 0.1
    with options(snes_divergence_tolerance=1e3):  # PETSc's test, if the option is given
        snes = solver.create(p, "clamp", "linesearch")
        snes.solve(None, bent)
    assert solver.converged_reason(snes) == "DIVERGED_DTOL"


@pytest.mark.one_debian("ranks")
@mpi
def test_step_tolerance(comm):
    with options(snes_stol=1e-2, snes_scaled_tol=0):
        snes, _ = solve(twist(comm))
    assert solver.converged_reason(snes) == "CONVERGED_SNORM_RELATIVE"


@mpi
@pytest.mark.parametrize("key", ["snes_hessian", "snes_adaptive_filter"])
def test_unknown_values_are_bad_input_on_every_rank(comm, key):
    p = twist(comm, cells=1)
    with options(**{key: "clam"}):
        with pytest.raises(BadInput, match=r" = 'clam': expected one of .*did you mean 'clamp'"):
            solver.create(p)
    with pytest.raises(
        BadInput, match=r"hessian = 'exakt': expected one of .*did you mean 'exact'"
    ):
        solver.create(p, "exakt")
    with pytest.raises(
        BadInput, match=r"predictor = 'tangnt': expected one of .*did you mean 'tangent'"
    ):
        solver.Predictor(p, solver.create(p), "tangnt")


@mpi
@pytest.mark.parametrize(
    "key, value",
    [("snes_scaled_tol", "abc"), ("pc_type", "jacoby"), ("ksp_python_type", "no_module.Class")],
)
def test_values_that_petsc_rejects_are_bad_input_on_every_rank(comm, key, value):
    p = twist(comm, cells=1)
    with options(**{key: value}):
        with pytest.raises(BadInput, match="PETSc rejects an option under -snh_"):
            solver.create(p)


#: Below and above what each number accepts; None where there is no bound.
REFUSED = {
    "snes_scaled_tol": (-1e-9, 1.1e-2),
    "snes_forcing_max": (-0.1, 1),
    "snes_forcing_safeguard": (-0.1, 1.1),
    "snes_adaptive_retry": (-0.1, 1.1),
    "snes_armijo": (-1e-4, 0.5),
    "snes_min_step": (-1e-4, 1),
    "snes_lbfgs_max_it": (-1, 0.5),
    "snes_lbfgs_rtol": (-0.1, 1.1),
    "snes_tr_eta1": (-0.1, 1),
    "snes_tr_eta2": (-0.1, 1.1),
    "snes_tr_eta3": (-0.1, None),
    "snes_tr_t1": (0, 1),
    "snes_tr_t2": (0.9, None),
    "snes_tr_delta0": (-1, None),
    "snes_tr_deltamax": (0, None),
    "snes_tr_max_attempts": (0, 1.5),
    "snes_tr_enter_decrease": (-0.1, None),
    "snes_tr_enter_residual": (-0.1, None),
    "snes_tr_exit_residual": (-0.1, 1.1),
    # PETSc's own
    "snes_max_it": (-1, None),
    "snes_rtol": (-0.1, 1),
    "snes_stol": (-0.1, 1e300),
    "snes_atol": (-1, 1e300),
    "ksp_rtol": (-0.1, 1),
    "ksp_atol": (-1, None),
    "ksp_divtol": (0.5, None),
    "ksp_max_it": (0, 0.5),
    "ksp_deflation_subdomains": (-2, None),
    "trust_ksp_rtol": (-0.1, 1),
    "fieldsplit_u_ksp_rtol": (-0.1, 1),
}


@mpi
def test_numbers_out_of_range_are_refused(comm):
    """One line names the option, its value and what it accepts; NaN is never accepted."""
    assert {k for k, option in OPTIONS.items() if not isinstance(option.default, str)} <= {*REFUSED}
    p = twist(comm, cells=1)
    for key, bounds in REFUSED.items():
        for value in (*bounds, "nan"):
            if value is None:
                continue
            with options(**{key: value}):
                with pytest.raises(BadInput, match=rf"^{key} = \S+: expected a (whole )?number >"):
                    solver.create(p)
    for key, option in OPTIONS.items():  # the defaults and the bounds themselves are accepted
        if isinstance(option.accepted, Range) and not option.accepted.open_low:
            with options(**{key: option.accepted.low}):
                solver.create(p)


@mpi
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("snes_type", "newtonls"), ("snes_type", "newtontr"), ("snes_python_type", "a.b"),
        ("snes_mf", None), ("snes_mf_operator", None), ("snes_fd", None), ("snes_fd_color", None),
    ],
)  # fmt: skip
def test_what_replaces_the_solver_is_refused(comm, key, value):
    """With another type of SNES PETSc ended in a segmentation fault."""
    p = twist(comm, cells=1)
    snes = solver.create(p)
    with options(**{key: value}):
        for read in (lambda: solver.create(p), snes.setFromOptions):
            with pytest.raises(BadInput, match=rf"^{key} = '{value or ''}': expected no value: "):
                read()
    snes.solve(None, p.x)
    assert snes.getConvergedReason() > 0


@mpi
@pytest.mark.parametrize("kind", [KeyboardInterrupt, BadInput])
def test_exceptions_of_callbacks_pass_unchanged(comm, kind):
    p = twist(comm, cells=2)
    snes = solver.create(p)

    def monitor(snes, its, norm):
        if its == 1:
            raise kind("enough")

    snes.setMonitor(monitor)
    solver.Predictor(p, snes, "none").predict(1.0)
    with pytest.raises(kind, match="enough"):
        with solver.callback_errors():
            snes.solve(None, p.x)


#: Linear solves from outside the SNES.
SOLVES = {
    "predictor": lambda p, snes: solver.Predictor(p, snes, "tangent").tangent(),
    "estimate": lambda p, snes: HessianSolver(p, snes.getKSP(), 1e-6)([p.x]),
    "definiteness": lambda p, snes: is_definite(p, snes.getKSP()),
    "any": lambda p, snes: snes.getKSP().solve(p.x, p.x.duplicate()),
}


@mpi
@pytest.mark.parametrize("name", SOLVES)
def test_exceptions_of_callbacks_pass_linear_solves_unchanged(comm, name):
    """Ctrl-C in a predictor or in an estimate is no error of PETSc."""
    p = twist(comm, cells=2)
    p.x.set(1.0)
    snes = solver.create(p)
    set_operators(snes.getKSP(), p.A, p.A)
    p.jacobian(p.x, "exact" if name == "definiteness" else "clamp")

    def monitor(ksp, its, norm):
        raise KeyboardInterrupt("enough")

    snes.getKSP().setMonitor(monitor)
    outer = solver.petsc_failures() if name == "any" else nullcontext()
    with pytest.raises(KeyboardInterrupt, match="enough"), outer:
        SOLVES[name](p, snes)


def test_petsc_options_are_restored():
    assert not [k for k in PETSc.Options().getAll() if k.startswith(solver.PREFIX)]


def test_an_unknown_solver_of_petsc_is_refused_in_one_line(comm):
    p = twist(comm)
    with options(ksp_type="foo"), pytest.raises(BadInput) as error:
        solver.create(p)
    message = str(error.value)
    assert "foo" in message and "\n" not in message and "SNESSetFromOptions" not in message


MISTAKES = """
import gc, sys
from mpi4py import MPI
from petsc4py import PETSc
from solver_problems import twist
from fem_snh import solver
from fem_snh.accuracy.duals import HessianSolver
from fem_snh.errors import BadInput
gc.set_threshold(20)
p = twist(MPI.COMM_SELF, cells=1)
PETSc.Options(solver.PREFIX)["snes_tr_eta3"] = "-0.1"
refused = 0
for _ in range(500):
    try:
        solver.create(p)
    except BadInput:
        refused += 1
print(refused, gc.isenabled())
"""


def test_collections_of_garbage_lose_no_error():
    """On its way through PETSc an error is lost by Python 3.13's collector: the program crashed."""
    done = subprocess.run(
        [sys.executable, "-c", MISTAKES], cwd=SUPPORT, capture_output=True, text=True
    )
    assert done.stdout.split() == ["500", "True"], done.stderr
