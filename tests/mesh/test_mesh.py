"""Generated meshes and .msh files: what is in them, and that every rank finds its groups."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import FACES
from gmsh_files import BOX, write_msh

from fem_snh import _dolfinx
from fem_snh.mesh import mesh, mesh_checks

pytestmark = pytest.mark.mpi
CELLS = ["hexahedron", "tetrahedron"]


def volume(m: mesh.Mesh) -> float:
    """By our own quadrature, which checks the tabulated geometry, too."""
    points, weights = _dolfinx.quadrature(m.cell, 4)
    x = _dolfinx.geometry_x(m.domain)[_dolfinx.geometry_dofs(m.domain)]
    gradients = _dolfinx.tabulate_geometry(m.domain, points)
    jacobian = np.einsum("cni,pnj->cpij", x, gradients)
    return m.domain.comm.allreduce(float((abs(np.linalg.det(jacobian)) @ weights).sum()))


def area(m: mesh.Mesh, name: str) -> float:
    one = 1 + 0 * _dolfinx.coordinates(m.domain)[0]
    measure = _dolfinx.surface_measure(m.domain, m.group(name).entities)
    return _dolfinx.assemble_scalar(_dolfinx.form(one * measure))


def held_points(m: mesh.Mesh, name: str, degree: int) -> np.ndarray:
    """(n, 3) the sorted points of a group's nodes, each once, from all ranks."""
    V = _dolfinx.function_space(m.domain, degree, (3,))
    group = m.group(name)
    nodes = _dolfinx.locate_dofs(V, group.dim, group.entities)
    points = V.tabulate_dof_coordinates()[nodes[nodes < _dolfinx.num_nodes(V)[0]]]
    points = np.concatenate(m.domain.comm.allgather(points))
    return np.array(sorted(points.round(9).tolist())).reshape(-1, 3)


# --- what the sources generate -----------------------------------------------------------------


@pytest.mark.one_debian
@pytest.mark.parametrize("cell", CELLS)
def test_cube_is_the_unit_cube_with_its_six_faces(comm, cell):
    n = 3
    m = mesh.generate(comm, "cube", cell, cells=n)
    per_cube, per_square = (1, 1) if cell == "hexahedron" else (6, 2)
    assert (m.cell, m.num_cells) == (cell, per_cube * n**3)
    assert volume(m) == pytest.approx(1, abs=1e-12)
    assert {g.name: (g.dim, g.count) for g in m.groups} == {
        "corners": (0, 8),
        **dict.fromkeys((f"corner_{i:03b}" for i in range(8)), (0, 1)),
        "body": (3, per_cube * n**3),
        **dict.fromkeys(FACES, (2, per_square * n**2)),
    }
    for corner in ("000", "100", "010", "011"):
        assert held_points(m, f"corner_{corner}", 2).tolist() == [[float(c) for c in corner]]
    faces = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1)}
    for name, (axis, value) in {**faces, "bottom": (2, 0), "top": (2, 1)}.items():
        assert area(m, name) == pytest.approx(1, abs=1e-12)
        for degree in (1, 2):
            points = held_points(m, name, degree)
            assert len(points) == (degree * n + 1) ** 2
            assert np.allclose(points[:, axis], value)
    assert held_points(m, "corners", 2).tolist() == [
        [i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    assert len(held_points(m, "body", 2)) == (2 * n + 1) ** 3


@pytest.mark.one_debian
@pytest.mark.parametrize("cell", CELLS)
def test_cylinder_converges_in_second_order_and_its_cells_keep_their_shape(comm, cell):
    radius, length = 0.4, 1.3
    exact = np.pi * radius**2 * length
    errors = []
    for cells in (5, 10, 20):
        m = mesh.generate(comm, "cylinder", cell, cells=cells, radius=radius, length=length)
        errors.append(exact - volume(m))
        worst = comm.allreduce(mesh_checks.scaled_jacobian(m.domain).min(initial=1), op=MPI.MIN)
        assert worst > (0.82 if cell == "hexahedron" else 0.16)
    # A core of 3/5 of the cells gives 12/5 cells chords on the circle.
    assert np.allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2, atol=0.05)
    assert area(m, "left") == pytest.approx(np.pi * radius**2, rel=0.01)
    assert area(m, "right") == pytest.approx(area(m, "left"), rel=1e-12)
    assert area(m, "side") == pytest.approx(2 * np.pi * radius * length, rel=0.01)
    assert np.allclose(held_points(m, "right", 1)[:, 0], length)


# --- files -------------------------------------------------------------------------------------


@pytest.mark.one_debian
@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_msh_files_keep_cells_and_overlapping_groups_of_any_dimension(
    comm, folder, cell, order, version
):
    recombine = "Recombine;" if cell == "hexahedron" else ""
    script = BOX.replace("RECOMBINE", recombine)
    m = mesh.read(comm, write_msh(comm, folder, script, version, order, binary=order == 2))
    per_cube, per_square = (1, 1) if cell == "hexahedron" else (6, 2)
    assert (m.cell, m.num_cells) == (cell, 16 * per_cube)
    assert volume(m) == pytest.approx(2, abs=1e-12)
    assert _dolfinx.geometry_degree(m.domain) == order
    assert {(g.name, g.dim): g.count for g in m.groups} == {
        ("all", 3): 16 * per_cube,
        ("second", 3): 8 * per_cube,
        ("start", 2): 4 * per_square,
        ("middle", 2): 4 * per_square,
        ("both ends", 2): 8 * per_square,
        ("edge", 1): 2,
        ("42", 0): 1,
        ("astray", 0): 0,
    }
    for degree in (1, 2):
        n = 2 * degree + 1
        assert len(held_points(m, "start", degree)) == n**2
        assert len(held_points(m, "both ends", degree)) == 2 * n**2
        assert len(held_points(m, "second", degree)) == n**3
        assert np.allclose(held_points(m, "middle", degree)[:, 0], 1)
        edge = np.linspace(0, 1, n)
        assert np.allclose(held_points(m, "edge", degree), [[0, y, 0] for y in edge])
        assert held_points(m, "42", degree).tolist() == [[0, 0, 0]]


@pytest.mark.one_debian
def test_order_2_meshes_are_curved(comm, folder):
    disc = "SetFactory('OpenCASCADE'); Cylinder(1) = {0, 0, 0, 1, 0, 0, 1};"
    disc = disc.replace("'", '"') + "Mesh.MeshSizeMax = 0.6; Physical Volume(1) = {1};"
    straight = np.pi - volume(mesh.read(comm, write_msh(comm, folder, disc, order=1)))
    curved = np.pi - volume(mesh.read(comm, write_msh(comm, folder, disc, order=2)))
    assert 0 < 20 * abs(curved) < straight


@pytest.mark.one_debian("ranks")
def test_each_entity_is_owned_once_and_known_wherever_it_is(comm):
    """On every rank, a facet is in the group if and only if its vertices lie on the face."""
    m = mesh.generate(comm, "cube", "tetrahedron", cells=3)
    facets = _dolfinx.input_vertices(m.domain, 2)
    x = np.full((facets.max(initial=0) + 1, 3), np.nan)
    cells = _dolfinx.geometry_dofs(m.domain)
    x[_dolfinx.input_vertices(m.domain, 3)] = _dolfinx.geometry_x(m.domain)[cells]
    expected = np.flatnonzero((x[facets][:, :, 0] < 1e-12).all(axis=1))
    assert m.group("left").entities.tolist() == expected.tolist()
