"""Exports that cannot be made are one line, and leave no file behind."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mpi4py import MPI

import pytest
import pyvista as pv
from picture_runs import bad, write_run

from fem_snh.viewing import export
from fem_snh.viewing.states import States


@pytest.fixture
def twisted(tmp_path: Path) -> Path:
    return write_run(MPI.COMM_SELF, tmp_path / "run", "Q1")


def rewrite(folder: Path, state: int, change: Any) -> None:
    """Change the grid of a state."""
    path = folder / f"fields_p0_{state:06}.vtu"
    grid: Any = pv.read(path)
    change(grid)
    grid.save(path)


def test_a_bad_state_leaves_the_earlier_file(twisted, tmp_path):
    (path,) = export.main(twisted, tmp_path / "a.vtkhdf")
    content = path.read_bytes()
    rewrite(twisted, 2, lambda grid: grid.cell_data.remove("J"))
    assert re.search("its fields are .*, those of the first load", bad(export.main, twisted, path))
    rewrite(twisted, 1, lambda grid: grid.points.__imul__(2))
    states = States(twisted / "fields.pvd")
    assert "its mesh is not that of the other loads" in bad(states.read, 1)
    (twisted / "fields_p0_000001.vtu").unlink()
    assert "missing" in bad(export.main, twisted, path)
    assert path.read_bytes() == content
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.vtkhdf", "run"]


@pytest.mark.parametrize(("part", "why"), [(0.5, "truncated"), (0.05, "damaged")])
def test_a_truncated_file_is_one_line(twisted, tmp_path, capfd, part, why):
    """VTK prints several lines of its own; one file has no data, the other no complete header."""
    file = twisted / "fields_p0_000001.vtu"
    file.write_bytes(file.read_bytes()[: int(part * file.stat().st_size)])
    message = bad(export.main, twisted, tmp_path / "a.vtkhdf")
    assert message.startswith(f"{file}: cannot be read: it is ") and why in message
    assert capfd.readouterr() == ("", "")
