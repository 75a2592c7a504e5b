"""Groups by name, and errors of geometries and mesh files: one line, on every rank."""

from __future__ import annotations

import pytest
from bodies import create_problem
from gmsh_files import BOX, write_msh

from fem_snh.assembly.elements import element
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh

pytestmark = pytest.mark.mpi
CELLS = ["hexahedron", "tetrahedron"]


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


def test_meshes_of_surfaces_are_refused(comm, folder):
    with pytest.raises(BadInput, match="no volume cells: mesh in 3 dimensions"):
        mesh.read(comm, write_msh(comm, folder, BOX.replace("RECOMBINE", ""), dim=2))


def test_cells_without_nodes_inside_are_refused_with_the_option_for_whole_ones(comm, folder):
    whole = BOX.replace("RECOMBINE", "Recombine;")
    lacking = whole + "Mesh.SecondOrderIncomplete = 1;"
    with pytest.raises(BadInput, match=r"cells Hexahedron 20:.*SecondOrderIncomplete = 0 .* 27 no"):
        mesh.read(comm, write_msh(comm, folder, lacking, order=2))
    assert mesh.read(comm, write_msh(comm, folder, whole, order=2)).cell == "hexahedron"
    with pytest.raises(BadInput, match=r"cells Tetrahedron 20:.*\(Mesh.ElementOrder = 2\)"):
        mesh.read(comm, write_msh(comm, folder, BOX.replace("RECOMBINE", ""), order=3))


@pytest.mark.one_debian
def test_prisms_and_mixed_cells_are_refused(comm, folder):
    prisms = """Point(1) = {0, 0, 0}; line[] = Extrude {1, 0, 0} { Point{1}; Layers{1}; };
        base[] = Extrude {0, 1, 0} { Line{line[1]}; Layers{1}; };
        Extrude {0, 0, 1} { Surface{base[1]}; Layers{1}; Recombine; }"""
    with pytest.raises(BadInput, match=r"has cells Prism 6: all must be tetra.*Recombine Surface"):
        mesh.read(comm, write_msh(comm, folder, prisms))
    whole = prisms.replace("{1}; };\n        Extrude", "{1}; Recombine; };\n        Extrude")
    assert mesh.read(comm, write_msh(comm, folder, whole)).cell == "hexahedron"
    mixed = BOX.replace("RECOMBINE", "Recombine;") + (
        "Point(200) = {0, 0, 3}; l[] = Extrude {1, 0, 0} { Point{200}; Layers{1}; };"
        "s[] = Extrude {0, 1, 0} { Line{l[1]}; Layers{1}; };"
        "v[] = Extrude {0, 0, 1} { Surface{s[1]}; Layers{1}; }; Physical Volume(9) = {v[1]};"
    )
    with pytest.raises(BadInput, match="has cells Tetrahedron 4 and Hexahedron 8"):
        mesh.read(comm, write_msh(comm, folder, mixed))


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


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize(
    ("cell", "name", "message"),
    [
        ("hexahedron", "P2", "one of Q1, Q1P0, Q2, Q2Q1: the mesh has hexahedra"),
        ("tetrahedron", "Q2", "one of P1, P2, P2P0, P2P1: the mesh has tetrahedra"),
    ],
)
def test_an_element_of_another_cell(comm, cell, name, message):
    """It said "it has tetrahedrons" of the element, in a sentence on the mesh."""
    cube = mesh.generate(comm, "cube", cell, cells=1)
    with pytest.raises(BadInput) as error:
        create_problem(cube, element(name), material("stable_neo_hookean", E=1.0, nu=0.3))
    assert str(error.value) == f"element = '{name}': expected {message}"
