"""Meshes in XDMF files: those of gmsh files and of dolfinx programs, read in parts by the ranks."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from gmsh_files import BOX, section, write_msh
from rectangles import rectangle
from test_mesh import area, held_points, volume

from fem_snh import _dolfinx
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.files import xdmf_data
from fem_snh.mesh import mesh

pytestmark = pytest.mark.mpi


def converted(comm, msh):
    """The mesh of a gmsh file, and that of its XDMF file."""
    before = mesh.read(comm, msh)
    mesh.write_xdmf(before, msh.with_suffix(".xdmf"))
    return before, mesh.read(comm, msh.with_suffix(".xdmf"))


# Hexahedra of order 2 are not in the XDMF files of dolfinx 0.5.
@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize(("recombine", "order"), [("", 1), ("", 2), ("Recombine;", 1)])
def test_mesh_and_groups_are_those_of_the_gmsh_file(comm, folder, recombine, order):
    path = write_msh(comm, folder, BOX.replace("RECOMBINE", recombine), order=order)
    before, after = converted(comm, path)
    assert (after.cell, after.num_cells) == (before.cell, before.num_cells)
    assert _dolfinx.geometry_degree(after.domain) == order
    assert volume(after) == pytest.approx(volume(before), rel=1e-12)
    with_part = {g.label: (g.tag, g.count) for g in before.groups if g.count}
    assert {g.label: (g.tag, g.count) for g in after.groups} == with_part
    assert area(after, "both ends") == pytest.approx(2.0, rel=1e-12)
    for name in ("both ends", "edge", "42", "second"):
        assert np.array_equal(held_points(after, name, 1), held_points(before, name, 1))


def test_every_rank_reads_its_part(comm, folder):
    made = mesh.generate(comm, "cube", "tetrahedron", cells=4)
    mesh.write_xdmf(made, folder / "cube.xdmf")
    cells, x, *_ = _dolfinx.read_xdmf(comm, folder / "cube.xdmf", "mesh")
    for part, total in ((cells, 6 * 4**3), (x, 5**3)):
        assert abs(len(part) - total / comm.size) <= 1
        assert comm.allreduce(len(part)) == total


@pytest.mark.one_debian("ranks")
def test_tags_of_a_dolfinx_program(comm, folder):
    """Grids named by the program, numbers for groups, and a name that its Information gives."""
    from dolfinx.io import XDMFFile
    from dolfinx.mesh import create_unit_square, locate_entities_boundary, meshtags

    domain, path = create_unit_square(comm, 3, 2), folder / "square.xdmf"
    domain.topology.create_connectivity(1, 2)
    ends = [
        locate_entities_boundary(domain, 1, lambda x, at=at: abs(x[0] - at) < 1e-9) for at in (0, 1)
    ]
    facets = np.concatenate(ends)
    values = np.repeat(np.array([5, 9], np.int32), [len(end) for end in ends])
    order = np.argsort(facets)
    tags = meshtags(domain, 1, facets[order].astype(np.int32), values[order])
    tags.name = "ends"
    with XDMFFile(comm, str(path), "w") as file:
        file.write_mesh(domain)
        more = [domain.geometry] if "write_meshtags" in vars(XDMFFile) else []
        file.write_meshtags(tags, *more)
        file.write_information("curve:9", "moved")
    m = mesh.read(comm, path)
    assert (m.cell, m.num_cells, m.dim) == ("triangle", 12, 2)
    found = [(g.label, g.tag, g.count) for g in m.groups]
    assert found == [("curve:5", 5, 2), ("curve:moved", 9, 2)]
    assert (held_points(m, "moved", 1)[:, 0] == 1).all()


def damaged(folder, path, kind):
    """A copy of an XDMF file with this damage, and what the message says."""
    other = folder / "bad.xdmf"
    text, data = path.read_text(), path.with_suffix(".h5")
    if kind == "no data":
        other.write_text(text.replace(data.name, "missing.h5"))
        return other, "No such file"
    shutil.copy(data, folder / "bad.h5")
    text = text.replace(data.name, "bad.h5")
    if kind == "not XML":
        text, message = text[:200], "not an XDMF file"
    elif kind == "truncated":
        (folder / "bad.h5").write_bytes(data.read_bytes()[:600])
        message = "grid 'mesh'"
    elif kind == "no cells":
        text, message = re.sub("Hexahedron|Quadrilateral", "PolyVertex", text), "no grid of cells"
    other.write_text(text)
    return other, message


@pytest.mark.parametrize("kind", ["no data", "not XML", "truncated", "no cells"])
def test_damaged_files_are_one_message_on_every_rank(comm, folder, kind):
    mesh.write_xdmf(mesh.generate(comm, "cube", "hexahedron", cells=2), folder / "cube.xdmf")
    comm.barrier()
    bad = comm.bcast(damaged(folder, folder / "cube.xdmf", kind) if comm.rank == 0 else None)
    with pytest.raises(BadInput, match=bad[1]):
        mesh.read(comm, bad[0])


def test_export_converts_a_gmsh_file(comm, folder, capfd):
    path = write_msh(comm, folder, BOX.replace("RECOMBINE", "Recombine;"))
    assert main(["export", str(path), str(folder / "box.xdmf")]) == 0
    assert {g.name for g in mesh.read(comm, folder / "box.xdmf").groups} >= {"second", "edge"}
    assert xdmf_data(folder / "box.xdmf") == [folder / "box.h5"]
    assert main(["export", str(path), str(folder / "box.obj")]) == 2


@pytest.mark.one_debian("ranks")
def test_a_section_has_two_dimensions(comm, folder):
    """dolfinx writes three coordinates of nodes in the plane, or two."""
    path = folder / "strip.msh"
    if comm.rank == 0:
        with section(path) as (geo, curves, surfaces):
            (*_, left), surface = rectangle(geo, (0, 0), (2, 1), (4, 2), True)
            surfaces["all"], curves["left"] = [surface], [left]
    comm.barrier()
    before, after = converted(comm, path)
    assert after.dim == before.dim == 2
    assert mesh.volume(after.domain) == pytest.approx(2.0, rel=1e-12)
    assert after.group("left").count == before.group("left").count
