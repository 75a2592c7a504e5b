"""The check before a solve and the doctor's table, here and where things are missing."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from mpi4py import MPI

import pytest

from fem_snh.cli import doctor
from fem_snh.errors import BadInput


@pytest.mark.one_debian("ranks")
@pytest.mark.mpi
def test_check_passes_here(comm: MPI.Intracomm) -> None:
    doctor.check()
    comm.barrier()


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["dolfinx", "gmsh", "pydantic"])
def test_check_names_what_is_missing(
    name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(BadInput, match=f"cannot import {name} .*make setup") as caught:
        doctor.check()
    assert "\n" not in str(caught.value)
    assert len(set(comm.allgather(str(caught.value)))) == 1


def test_table_is_all_there(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    for name in ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"):
        monkeypatch.setenv(name, "1")
    assert doctor.main() == 0, capsys.readouterr().out
    shown = capsys.readouterr().out
    for row in (
        "Python",
        "dolfinx",
        "PETSc",
        "SLEPc",
        "MPI ranks",
        "BLAS",
        "compiler",
        "cache folder",
    ):
        assert row in shown
    assert "missing" not in shown


#: What Open MPI prints with fewer cores than ranks, from its first line with words to its last.
NO_SLOTS = "---\\nThere are not enough slots available in the system\\nlaunch.\\n---\\n"


def test_table_says_what_to_do(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mpirun = tmp_path / "mpirun"
    mpirun.write_text(f"#!/bin/sh\nprintf -- '{NO_SLOTS}' >&2; exit 1\n")
    mpirun.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setenv("FEM_SNH_CACHE", str(mpirun / "not-a-folder"))
    assert doctor.main() == 2
    shown = capsys.readouterr().out
    missing = {line.split("  ")[0].strip() for line in shown.splitlines() if " missing " in line}
    assert missing == {"MPI ranks", "compiler", "cache folder"}, shown
    for remedy in ("set CC", "set FEM_SNH_CACHE", "mpirun --oversubscribe"):
        assert remedy in shown
