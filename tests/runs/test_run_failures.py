"""Steps that fail are halved; an interrupted run leaves its record."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from itertools import pairwise, product

from mpi4py import MPI

import psutil
import pytest
from bodies import PRESS
from running import record, rows, solve

from fem_snh.errors import BadInput
from fem_snh.studies.tasks import environment, program

mpi = pytest.mark.mpi


@pytest.mark.one_debian
@mpi
def test_failed_steps_are_rolled_back_and_halved(comm, folder):
    result = solve(PRESS, out=folder)
    assert result.converged
    steps = result.steps
    assert not steps[0]["converged"] and steps[0]["load"] == 1.0
    assert steps[0]["energy"] == pytest.approx(0, abs=1e-14) and steps[0]["volume_ratio"] == 1.0
    kept = 0.0
    for step, after in pairwise(steps):
        if step["converged"]:
            kept = step["load"]
            assert after["load"] > kept
        else:
            assert step["reason"].startswith("DIVERGED")
            assert after["load"] == pytest.approx((kept + step["load"]) / 2)
    assert steps[-1]["load"] == 1.0 and steps[-1]["converged"]
    comm.barrier()
    times = re.findall(r'timestep="([^"]+)"', (folder / "fields.pvd").read_text())
    done = [step["load"] for step in steps if step["converged"]]
    assert [float(t) for t in times] == pytest.approx([0.0, *done])
    comm.barrier()
    gradually = solve(PRESS, steps=8, predictor="extrapolate")
    assert all(step["converged"] for step in gradually.steps)
    assert steps[-1]["energy"] == pytest.approx(gradually.steps[-1]["energy"], rel=1e-9)


@pytest.mark.one_debian("ranks")
@mpi
def test_a_run_that_cannot_go_on_keeps_what_it_has(comm, folder):
    """Two Newton iterations are enough for small steps only, and not for these."""
    result = solve("twist", cells=2, angle=3.0, out=folder, petsc={"snes_max_it": 1})
    comm.barrier()
    found = record(folder)
    assert not result.converged and found["converged"] is False
    assert found["status"] == result.status
    assert re.fullmatch(
        r"stopped at load 0: a step of 1/64 of the nominal one still fails \(DIVERGED_MAX_IT\)",
        found["status"],
    )
    assert [step["load"] for step in found["steps"]] == [2.0**-k for k in range(1, 8)]
    assert {step["reason"] for step in found["steps"]} == {"DIVERGED_MAX_IT"}
    assert len(rows(folder)) == 7 and not result.problem.x.norm()
    assert result.problem.load == 0
    comm.barrier()


#: Whether mpirun sends SIGKILL only (Open MPI 6: `surekill` of PRRTE 5), not SIGTERM first.
KILLS = int((re.search(r"Open MPI v(\d+)", MPI.Get_library_version()) or "00")[1]) >= 6


@pytest.mark.parametrize(
    "receiver, name", [*product(("program", "mpirun"), ("SIGINT", "SIGTERM")), ("ranks", "SIGTERM")]
)
def test_an_interrupted_run_leaves_its_record(tmp_path, receiver, name):
    """run.json can be read at any time, and says how it ended.

    Users interrupt mpirun; batch systems can signal the ranks themselves.
    """
    ranks = 1 if receiver == "program" else 2
    words = ["run", "stretch", "--cells", "8", "--steps", "200", "--quiet", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*program(ranks), *words], env=environment(), stderr=subprocess.PIPE, text=True
    )
    seen, late = 0, time.monotonic() + 60
    try:
        while seen < 2 and time.monotonic() < late:
            assert process.poll() is None
            time.sleep(0.01)
            if (tmp_path / "run.json").exists():  # readable whenever we look
                found = record(tmp_path)
                seen = len(found.get("steps", []))
                assert found.get("status", "running") == "running"
        signalled = psutil.Process(process.pid)
        for each in signalled.children() if receiver == "ranks" else [signalled]:
            each.send_signal(getattr(signal, name))
        _, errors = process.communicate(timeout=20)
    finally:
        process.kill()
    found = record(tmp_path)
    assert seen >= 2 and len(found["steps"]) >= seen and not found["converged"]
    assert len(rows(tmp_path)) >= seen
    assert process.returncode != 0 and "Traceback" not in errors
    killed = receiver == "mpirun" and KILLS
    assert found["status"] == ("running" if killed else "interrupted")
    if ranks == 1:
        assert process.returncode == 130
        assert errors.strip() == "fem-snh: error: interrupted; what was computed is kept"
        pvd = (tmp_path / "fields.pvd").read_text()
        assert pvd.count("<DataSet") == len(found["steps"]) + 1 and "</VTKFile>" in pvd


@mpi
def test_input_that_one_rank_rejects_is_rejected_on_every_rank(comm):
    """A file that only some ranks can read, as without a network file system, does not hang."""
    last = comm.rank == comm.size - 1
    with pytest.raises(BadInput, match="element = 'Q7': expected one of"):
        solve("twist", cells=2, element="Q7" if last else "Q1")
