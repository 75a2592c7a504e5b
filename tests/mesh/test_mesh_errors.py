"""Groups by name, and errors of geometries and mesh files: one line, on every rank."""

from __future__ import annotations

import pytest
from gmsh_files import BOX, write_msh

from fem_snh.errors import BadInput
from fem_snh.mesh import mesh

pytestmark = pytest.mark.mpi


# --- what users get wrong ----------------------------------------------------------------------


def test_groups_are_named_by_name_number_or_dimension(comm, folder):
    m = mesh.read(comm, write_msh(comm, folder, BOX.replace("RECOMBINE", "")))
    assert m.group("start") is m.group("surface:start")
    assert m.group(42) is m.group("42")
    assert m.group(7) is m.group("all")
    with pytest.raises(BadInput, match=r"did you mean 'middle'.*curve:edge, surface:start"):
        m.group("midle")
    with pytest.raises(BadInput, match="'surface:start' or 'volume:second'"):
        m.group(3)
    with pytest.raises(BadInput, match="'astray' has no part in the mesh"):
        m.group("astray")


@pytest.mark.parametrize(
    ("source", "cell", "parameters", "message"),
    [
        ("cylindre", "hexahedron", {}, "mesh.source = 'cylindre': .*cube, cylinder.*'cylinder'"),
        (
            "cube",
            "prism",
            {},
            "cell = 'prism': .* hexahedron, quadrilateral, tetrahedron, triangle",
        ),
        ("cube", "hexahedron", {"cels": 3}, "unknown parameter 'cels': .*'cells'"),
        ("cube", "hexahedron", {"tets": 1}, "unknown parameter 'tets'"),
        ("cube", "hexahedron", {"cells": 0}, "'cube'.*cells = 0: expected a whole number"),
        ("cylinder", "hexahedron", {"cells": 2.5}, "cells = 2.5: expected a whole number, 3"),
        ("cylinder", "tetrahedron", {"radius": -1}, "radius = -1.*expected positive numbers"),
        ("cylinder", "tetrahedron", {"length": float("nan")}, "length = nan: .* finite"),
    ],
)
def test_bad_geometries_are_one_line_on_every_rank(comm, source, cell, parameters, message):
    with pytest.raises(BadInput, match=message) as caught:
        mesh.generate(comm, source, cell, **parameters)
    assert "\n" not in str(caught.value)
    assert mesh.generate(comm, "cube", "hexahedron", cells=1).num_cells == 1  # gmsh is fine again


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read: No such file"),
        (b"", "not a gmsh .msh file"),
        (b'SystemCall "touch gotcha";\n', "not a gmsh .msh file"),
        (b'$Nodes\nSystemCall "touch gotcha";\n', "not a gmsh .msh file"),
        (bytes(range(256)) * 9, "not a gmsh .msh file"),
        (b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 2 3\n", "gmsh: .*nodes"),
        (b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "no volume cells"),
    ],
)
def test_bad_files_are_one_line_on_every_rank(comm, folder, capfd, monkeypatch, content, message):
    monkeypatch.chdir(folder)
    path = folder / "bad.msh"
    if comm.rank == 0 and content is not None:
        path.write_bytes(content)
    comm.barrier()
    with pytest.raises(BadInput, match=message) as caught:
        mesh.read(comm, path)
    assert "bad.msh" in str(caught.value) and "\n" not in str(caught.value)
    assert not (folder / "gotcha").exists()
    assert capfd.readouterr() == ("", "")


def test_inverted_cells_are_refused(comm, folder):
    path = folder / "inverted.msh"
    if comm.rank == 0:
        # A hexahedron whose top is turned by half a turn against its bottom.
        x = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (1, 1, 1), (0, 1, 1), (0, 0, 1), (1, 0, 1)]
        nodes = "".join(f"{i} {a} {b} {c}\n" for i, (a, b, c) in enumerate(x, 1))
        path.write_text(
            f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n8\n{nodes}$EndNodes\n"
            "$Elements\n1\n1 5 2 1 1 1 2 3 4 5 6 7 8\n$EndElements\n"
        )
    comm.barrier()
    with pytest.raises(BadInput, match="has 1 inverted or degenerate cells of 1"):
        mesh.read(comm, path)


@pytest.mark.one_debian("ranks")
def test_gmsh_is_silent_and_leaves_control_c_alone(comm, capfd):
    import signal

    before = signal.getsignal(signal.SIGINT)
    mesh.generate(comm, "cube", "tetrahedron", cells=2)
    assert signal.getsignal(signal.SIGINT) is before
    assert capfd.readouterr() == ("", "")
