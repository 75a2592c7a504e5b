"""Files of users that would execute commands, crash a library or never end: one line each."""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path
from typing import Any

from mpi4py import MPI

import pytest
from gmsh_files import BOX, write_msh

from fem_snh import processes
from fem_snh.errors import BadInput
from fem_snh.mesh import mesh
from fem_snh.studies.tasks import environment, program
from fem_snh.viewing import run_elsewhere

# Node -1 does not exist: gmsh 4.8 reads beyond the end of its table of nodes, and crashes.
INVALID_NODE = """$MeshFormat
4.1 0 8
$EndMeshFormat
$Entities
0 0 0 1
1 0 0 0 1 1 1 0 0
$EndEntities
$Nodes
1 3 1 3
3 1 0 3
1
2
3
0 0 0
1 0 0
0 1 0
$EndNodes
$Elements
1 1 1 1
3 1 4 1
1 -1 1 2 3
$EndElements
"""


@pytest.mark.one_debian
@pytest.mark.mpi
def test_the_options_beside_a_mesh_are_not_executed(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """gmsh executes m.msh.opt when it merges m.msh; nor does it take a numpy.py beside it."""
    path = write_msh(comm, folder, BOX.replace("RECOMBINE", ""))
    expected = mesh.read(comm, path)
    monkeypatch.chdir(folder)
    if comm.rank == 0:
        Path("mesh.msh.opt").write_text(f'SystemCall "touch {folder}/executed";\n')
        Path("numpy.py").write_text(f"open('{folder}/executed', 'w')\n")
    comm.barrier()
    assert mesh.read(comm, "mesh.msh").num_cells == expected.num_cells
    assert not (folder / "executed").exists()


@pytest.mark.mpi
def test_a_mesh_that_crashes_gmsh_is_one_line_on_every_rank(
    comm: MPI.Intracomm, folder: Path
) -> None:
    if comm.rank == 0:
        (folder / "bad.msh").write_text(INVALID_NODE)
    comm.barrier()
    with pytest.raises(BadInput, match=r"^mesh '.*bad.msh': gmsh") as caught:
        mesh.read(comm, folder / "bad.msh")
    assert "\n" not in str(caught.value)


# --- functions in a process of their own --------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "args", "message"),
    [
        (ctypes.string_at, (0,), r"libc crashed \(SIGSEGV\)"),
        (os.abort, (), r"libc crashed \(SIGABRT\)"),
        (os._exit, (3,), "libc ended with exit code 3"),
    ],
)
def test_a_crash_is_one_line(function: Any, args: Any, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        processes.call("libc", function, *args)


@pytest.mark.parametrize("module", ["numpy", "json", "fem_snh"])
def test_no_process_imports_from_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    """Those of studies and of pictures: Python's -m would."""
    monkeypatch.chdir(tmp_path)
    Path(f"{module}.py").write_text("open('executed', 'w')\n")
    command = [*program(1), "--version"]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True)
    assert done.stdout.startswith("fem-snh "), done.stderr
    with pytest.raises(
        BadInput, match="AttributeError: 'dict' object"
    ):  # it ran the package's own module
        run_elsewhere("fem_snh.viewing.render.drawing:draw", {})
    assert not Path("executed").exists()
