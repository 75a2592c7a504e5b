"""PETSc's options, monitors, views, tolerances and errors of the SNES."""

from __future__ import annotations

from petsc4py import PETSc

import pytest
from solver_problems import options, solve, twist

from fem_snh import solver
from fem_snh.errors import BadInput, Range
from fem_snh.solver.options import OPTIONS

mpi = pytest.mark.mpi


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


#: Below and above what each number accepts; None where there is no bound.
REFUSED = {
    "snes_scaled_tol": (-1e-9, 1.1e-2),
    "snes_forcing_max": (-0.1, 1),
    "snes_forcing_safeguard": (-0.1, 1.1),
    "snes_lbfgs_max_it": (-1, 0.5),
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
