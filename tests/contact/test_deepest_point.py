"""Corners and small obstacles between the points at which contact acts: depth, place, note."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Condition, Hold, create_problem, cube
from contact_problems import contact_problem, plane, press, translation
from test_sharp_contact import DIAGONAL

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.unknowns import local_values
from fem_snh.contact.body_contact import BodyContact, BodyPair
from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.geometry.motions import MovingShape
from fem_snh.geometry.shapes import Sphere
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.problem.state_notes import penetration_note

mpi = pytest.mark.mpi


def pressed_corner(comm: MPI.Comm, element: str, cells: int) -> tuple[dict[str, Any], np.ndarray]:
    """Move a cube on its corner down by 0.2, with 0.01 between; return the row and the corner."""
    body = cube(comm, ELEMENTS[element].cell, cells)
    X = _dolfinx.geometry_x(body.domain)
    X[:] = DIAGONAL.apply(X - 0.5)
    floor = comm.allreduce(X[:, 2].min(), op=MPI.MIN) - 0.01
    move = [Condition("top", lambda X, load: 0 * X - [0, 0, 0.2 * load])]
    contact = RigidContact("floor", plane((0, 0, floor)))
    p, _, _ = contact_problem(body, element, [contact], move=move)
    row = press(p, 2)
    x = local_values(p.split(p.x)[0]).reshape(-1, 3) + p.V.tabulate_dof_coordinates()
    lowest = min(comm.allgather(x[x[:, 2].argmin()].tolist()), key=lambda x: x[2])
    return row, np.array([*lowest[:2], floor - lowest[2]])


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q1", "P1"])
def test_a_corner_is_deeper_than_its_points(comm: MPI.Comm, element: str) -> None:
    """The lowest node is the deepest point, on any number of ranks."""
    for ranks in (comm, MPI.COMM_SELF):
        row, (x, y, depth) = pressed_corner(ranks, element, 2)
        floor = row["obstacles"]["floor"]
        assert floor["deepest"] == pytest.approx(depth, rel=1e-12)
        assert floor["deepest_at"][:2] == pytest.approx([x, y], abs=1e-12)
        assert 0 < 2 * floor["penetration"] < depth and row["notes"] == ["penetration"]


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("at", [(0.19, 0.31), (0.06, 0.44), (0.313, 0.187)])
def test_a_ball_between_the_points_of_the_grid(comm: MPI.Comm, at: tuple[float, float]) -> None:
    """A ball of an eighth of the facet, half way through, between all points of the first grid."""
    ball = MovingShape(Sphere((*at, 1.1), 0.031), translation((0, 0, -0.1)))
    contacts = [RigidContact("ball", ball)]
    p, _, _ = contact_problem(cube(comm, "hexahedron", 2), "Q1", contacts, hold=[Hold("bottom")])
    row = press(p)
    found = row["obstacles"]["ball"]
    assert found["force"] == [0, 0, 0] and row["notes"] == ["penetration"]
    x, y, z = found["deepest_at"]
    assert np.hypot(x - at[0], y - at[1]) <= 0.5 / 128 * 2**0.5 + 1e-9
    assert z == pytest.approx(1) and 0.031 - 0.0056 < found["deepest"] <= 0.031


@pytest.mark.one_debian("ranks")
@mpi
def test_a_corner_in_another_body(comm: MPI.Comm) -> None:
    """At rest, by geometry: its points are 2 s / sqrt(3) higher, with s the first of 4 of Gauss."""
    overlap, first = 0.1, (1 - np.sqrt(3 / 7 + 2 / 7 * np.sqrt(6 / 5))) / 2
    for ranks in (comm, MPI.COMM_SELF):
        body = mesh.generate(ranks, "two_blocks", "hexahedron", cells=1, gap=1.0)
        X = _dolfinx.geometry_x(body.domain)
        upper = X[:, 2] > 1.5
        X[upper] = DIAGONAL.apply(X[upper] - [0.5, 0.5, 2.5])
        lowest = ranks.allreduce(X[upper, 2].min(initial=9.0), op=MPI.MIN)
        X[upper] += [0.57, 0.55, 1 - overlap - lowest]

        def loads(body: Any, u: Any, regions: Any, _: Any) -> list[BodyContact]:
            facets, cells, _ = _dolfinx.exterior_facets(body.domain)
            corners = _dolfinx.geometry_x(body.domain)[_dolfinx.geometry_dofs(body.domain)[cells]]
            lower_top = body.group("lower_top").entities
            pair = BodyPair("blocks", lower_top, facets[corners[..., 2].max(axis=1) > 1.5])
            return [BodyContact(u.function_space, regions, [pair])]

        snh, held = material("stable_neo_hookean", 1.0, 0.3), [Hold("bottom"), Hold("top")]
        p = create_problem(body, ELEMENTS["Q1"], snh, hold=held, loads=loads)
        row = p.history.record(p.split(p.x)[0])
        pair = row["contacts"]["blocks"]
        assert pair["deepest"] == pytest.approx(overlap, rel=1e-9)
        assert pair["deepest_at"] == pytest.approx([0.57, 0.55, 1 - overlap], abs=1e-9)
        assert pair["penetration"] == pytest.approx(overlap - 2 * first / 3**0.5, rel=1e-9)
        note = penetration_note({0: row | {"load": 1.0}})
        assert note.text.startswith("contact 'blocks': in 1 of 1 steps")
