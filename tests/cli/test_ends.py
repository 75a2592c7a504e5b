"""Ends of a run from outside: closed standard streams, a full disk, Ctrl-C pressed repeatedly."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROGRAM = [sys.executable, "-m", "fem_snh"]
RUN = [*PROGRAM, "run", "twist", "--cells", "2"]
#: Runs fem-snh with files of at most 4 kB, as on a full disk: checkpoint.npz is larger.
LIMITED = """
import resource, signal, sys
from mpi4py import MPI  # Open MPI has larger files of its own
from fem_snh import cli
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
sys.exit(cli.main(["run", "twist", "--cells", "4", "--out", "run"]))
"""


@pytest.mark.parametrize("closed", ["0<&-", "1>&-", "2>&-", "0<&- 1>&- 2>&-"])
def test_closed_standard_streams(tmp_path: Path, closed: str) -> None:
    command = f'exec "$@" {closed}'
    for words, code in ((RUN, 0), ([*RUN, "--nu", "2"], 2), ([*PROGRAM, "materials"], 0)):
        done = subprocess.run(
            ["bash", "-c", command, "bash", *words], cwd=tmp_path, capture_output=True, text=True
        )
        assert done.returncode == code
        assert "Traceback" not in done.stderr and done.stderr.count("\n") == (
            code == 2 and "2>" not in closed
        )


@pytest.mark.one_debian
def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    subprocess.run([*PROGRAM, "run", "twist", "--cells", "4"], cwd=tmp_path, check=True)
    done = subprocess.run(
        [sys.executable, "-c", LIMITED], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr == "fem-snh: error: cannot write run/checkpoint.npz: File too large\n"


def test_ctrl_c_pressed_repeatedly(tmp_path: Path) -> None:
    """One line, and the status of the run."""
    run = subprocess.Popen(
        [*PROGRAM, "run", "twist", "--cells", "12", "--steps", "400", "--out", "run"],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    record = tmp_path / "run" / "run.json"
    while not (record.exists() and json.loads(record.read_text())["steps"]):
        assert run.poll() is None
        time.sleep(0.05)
    for _ in range(4):
        os.kill(run.pid, signal.SIGINT)
        time.sleep(0.01)
    _, errors = run.communicate()
    assert run.returncode == 130
    assert errors == "fem-snh: error: interrupted; what was computed is kept\n"
    assert json.loads(record.read_text())["status"] == "interrupted"
