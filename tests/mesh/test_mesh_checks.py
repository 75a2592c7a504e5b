"""What a mesh may be: cells of any handedness that do not overlap, of a size that numbers hold."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import Press, vector_space

import fem_snh
from fem_snh import _dolfinx
from fem_snh.errors import BadInput
from fem_snh.mesh import mesh
from fem_snh.mesh.mesh_checks import check_geometry, unconnected_nodes

pytestmark = pytest.mark.mpi
CELLS = ["tetrahedron", "hexahedron"]
MATERIAL = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
#: Six tetrahedra of a cube, and exchanges of vertices that reflect a cell.
SIX = [(0, 1, 3, 7), (0, 1, 7, 5), (0, 5, 7, 4), (0, 3, 2, 7), (0, 6, 4, 7), (0, 2, 6, 7)]
REFLECTED = {"tetrahedron": [1, 0, 2, 3], "hexahedron": [1, 0, 3, 2, 5, 4, 7, 6]}


def cube(cell: str, n: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Cells and points of the unit cube, all cells right-handed."""
    points = np.array(list(itertools.product(range(n + 1), repeat=3)), dtype=float) / n
    number = np.arange((n + 1) ** 3).reshape(3 * [n + 1])
    cells = []
    for x, y, z in itertools.product(range(n), repeat=3):
        c = [number[x + i, y + j, z + k] for k in (0, 1) for j in (0, 1) for i in (0, 1)]
        cells += [[c[i] for i in t] for t in SIX] if cell == "tetrahedron" else [c]
    return np.array(cells), points


def numbered(cell: str, cells: np.ndarray, which: np.ndarray) -> np.ndarray:
    """The same cells, some of which are numbered left-handed."""
    return np.where(which[:, None], cells[:, REFLECTED[cell]], cells)


def domain(comm: Any, cell: str, cells: np.ndarray, x: np.ndarray, degree: int = 1) -> Any:
    """The dolfinx mesh that rank 0 provides."""
    if comm.rank:
        cells, x = cells[:0], x[:0]
    return _dolfinx.create_mesh(comm, cells, x, cell, degree)


NUMBERINGS = {"left-handed": lambda n: np.ones(n, bool), "both": lambda n: np.arange(n) % 3 == 0}


def energy_of(u: Any, tolerance: float, **keys: Any) -> float:
    """Energy of a body, solved in a dolfinx program."""
    options = {"snes_scaled_tol": tolerance}
    problem = fem_snh.NonlinearProblem(u, {MATERIAL: ufl.dx}, petsc_options=options, **keys)
    problem.solve()
    assert problem.solver.getConvergedReason() > 0
    F = ufl.Identity(3) + ufl.grad(u)
    return _dolfinx.assemble_scalar(_dolfinx.form(MATERIAL.ufl(F) * ufl.dx))


def energy_under_pressure(body: Any, degree: int, element: str | None) -> float:
    """Energy of a body that is pressed, with a pressure on its side."""
    press = Press(body, degree)
    terms = [0.01 * ufl.inner(ufl.FacetNormal(body), ufl.TestFunction(press.V)) * ufl.ds]
    return energy_of(press.u, 1e-11, bcs=press.bcs, terms=terms, element=element)


@pytest.mark.one_debian
@pytest.mark.parametrize("numbering", NUMBERINGS)
@pytest.mark.parametrize(
    ("cell", "degree", "element"),
    [
        ("tetrahedron", 1, None),
        ("tetrahedron", 2, "P2P0"),
        ("tetrahedron", 2, "P2P1"),
        ("hexahedron", 1, "Q1P0"),
        ("hexahedron", 2, None),
    ],
)
def test_handedness_is_a_matter_of_numbering(
    comm: Any, cell: str, degree: int, element: str | None, numbering: str
) -> None:
    """Cells with other numbers are the same body: the same energy."""
    cells, x = cube(cell)
    right = domain(comm, cell, cells, x)
    other = domain(comm, cell, numbered(cell, cells, NUMBERINGS[numbering](len(cells))), x)
    check_geometry(other, "mesh")
    assert mesh.volume(other) == pytest.approx(1, rel=1e-14)
    expected = energy_under_pressure(right, degree, element)
    assert energy_under_pressure(other, degree, element) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("repaired", [False, True])
def test_a_node_outside_of_its_neighbours(comm: Any, repaired: bool) -> None:
    """Also if the cells are numbered so that all are right-handed. Oracle: signs of volumes."""
    cells, x = cube("tetrahedron")
    x[13] = (1.8, 0.7, 0.6)  # the node in the centre
    a, b, c, d = (x[cells[:, i]] for i in range(4))
    volumes = np.linalg.det(np.stack([b - a, c - a, d - a], axis=1)) / 6
    assert np.abs(volumes).sum() > 1.3 and volumes.sum() == pytest.approx(1)
    facets = [[frozenset(np.delete(cell, i).tolist()) for i in range(4)] for cell in cells]
    signed = list(zip(volumes, map(set, facets), strict=True))
    bad = [any(v * w < 0 and f & g for w, g in signed) for v, f in signed]
    if repaired:
        cells = numbered("tetrahedron", cells, volumes < 0)
    body = domain(comm, "tetrahedron", cells, x)
    with pytest.raises(BadInput, match=f"^mesh has {sum(bad)} cells that overlap .* of 48, one at"):
        check_geometry(body, "mesh")
    u = fem.Function(vector_space(body))
    with pytest.raises(BadInput, match=r"^u.function_space.mesh has .* cells that overlap"):
        fem_snh.NonlinearProblem(u, {MATERIAL: ufl.dx})


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nodes_that_are_not_finite(comm: Any, cell: str, value: float) -> None:
    cells, x = cube(cell)
    x[5, 1] = value
    with pytest.raises(BadInput, match=r"^mesh has . nodes without finite coordinates of"):
        check_geometry(domain(comm, cell, cells, x), "mesh")


@pytest.mark.parametrize("size", [1e-100, 1e-60, 1e60, 1e200])
def test_sizes_whose_squares_no_number_holds(comm: Any, size: float) -> None:
    """At 1e-100 the residual was 0, and the answer -10 % for -4.66 %."""
    cells, x = cube("tetrahedron")
    with pytest.raises(BadInput, match=r"^mesh: its largest coordinate is .*: expected one from"):
        check_geometry(domain(comm, "tetrahedron", cells, size * x), "mesh")


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("size", [1e-40, 1e-15, 1e15, 1e40])
def test_a_body_of_any_other_size(comm: Any, size: float) -> None:
    """Energies scale with the volume."""
    cells, x = cube("tetrahedron")
    expected, found = (
        energy_of_press(domain(comm, "tetrahedron", cells, scale * x), scale)
        for scale in (1.0, size)
    )
    assert found == pytest.approx(expected, rel=1e-9)


def energy_of_press(body: Any, size: float) -> float:
    """Energy per volume of a cube of some size that is pressed by 30 %."""
    V = vector_space(body)
    u, lowered = fem.Function(V), fem.Function(V)
    x = V.tabulate_dof_coordinates()
    lowered.x.array[2::3] = -0.3 * x[:, 2]
    ends = np.flatnonzero((x[:, 2] < 0.01 * size) | (x[:, 2] > 0.99 * size)).astype(np.int32)
    return energy_of(u, 1e-9, bcs=[fem.dirichletbc(lowered, ends)]) / size**3


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("apart", [0.0, 1e-14, 0.5])
def test_cubes_that_meet_without_common_nodes(comm: Any, cell: str, apart: float) -> None:
    """The nine vertices of their faces coincide, to rounding."""
    cells, x = cube(cell)
    both = np.vstack([x, x + np.array([1 + apart, 0, 0])]) / 3
    body = domain(comm, cell, np.vstack([cells, cells + len(x)]), both)
    count, first = unconnected_nodes(body)
    assert count == (0 if apart > 0.1 else 9)
    assert first == pytest.approx([1 / 3, 0, 0] if count else [np.nan] * 3, nan_ok=True)
