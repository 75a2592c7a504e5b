"""Child processes of studies: limits, ranks, order of points."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from fem_snh.studies.tasks import Child, environment, program


def test_a_child_ends_with_all_its_ranks(tmp_path: Path) -> None:
    stubborn = "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(300)"
    mpirun = program(2)[:3]
    child = Child([*mpirun, sys.executable, "-c", stubborn], tmp_path / "log.txt", timeout=1)
    while child.poll() is None:
        time.sleep(0.1)
    assert child.limit_reached == "given up after 1 s" and not child.processes()


def is_running(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize("ranks", [1, 2])
def test_the_children_of_a_killed_study_end(tmp_path: Path, ranks: int) -> None:
    """They would write into its folder while it runs again."""
    sleep = [
        *program(ranks)[: 3 * (ranks > 1)],
        sys.executable,
        "-c",
        "import time; time.sleep(300)",
    ]
    code = f"""
import time
from pathlib import Path
from fem_snh.studies.tasks import Child
child = Child({sleep!r}, Path("log.txt"))
while len(child.processes()) < {ranks + (ranks > 1)}:
    time.sleep(0.01)
print(*(process.pid for process in child.processes()), flush=True)
time.sleep(300)
"""
    study = subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment(), stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert study.stdout is not None
    children = [int(pid) for pid in study.stdout.readline().split()]
    study.kill()
    study.wait()
    deadline = time.monotonic() + 30
    while any(map(is_running, children)):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    study.stdout.close()


def test_memory_is_counted_over_all_ranks(tmp_path: Path) -> None:
    """Neither rank alone is above the limit."""
    hungry = "import time; kept = b'x' * (300 << 20); time.sleep(300)"
    words = [*program(2)[:3], sys.executable, "-c", hungry]
    child = Child(words, tmp_path / "log.txt", timeout=30, memory=0.5)
    while child.poll() is None:
        time.sleep(0.05)
    assert child.limit_reached == "given up above 0.5 GiB" and not child.processes()
    alone = Child([sys.executable, "-c", hungry], tmp_path / "log.txt", timeout=1.5, memory=0.5)
    while alone.poll() is None:
        time.sleep(0.05)
    assert alone.limit_reached == "given up after 1.5 s"
