"""Planes of symmetry: rollers on planes of any inclination, in scenes, programs and in time."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Condition, Hold, cube, dense, norm, problem, set_values, wave
from gmsh_files import write_msh
from running import solve
from scipy.spatial import cKDTree

import fem_snh
from fem_snh import _dolfinx, scenes, solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import BadInput

mpi = pytest.mark.mpi
CORNER = ("left", "bottom", "back")


def rotation(*vector):
    """The rotation about a vector by its length (Rodrigues)."""
    angle = np.linalg.norm(vector)
    a, b, c = np.array(vector) / angle
    K = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


R = rotation(0.4, -0.7, 0.5)


def turned_cube(comm, element, turn):
    body = cube(comm, ELEMENTS[element].cell, 2, bend=0.05)
    x = _dolfinx.geometry_x(body.domain)
    x[:] = x @ turn.T
    return body


def loaded(comm, element, turn, **conditions):
    """A cube in a corner of rollers, pushed on two faces by dead loads."""
    loads = [("right", [0.1, 0.15, 0.05]), ("top", [0.1, -0.3, 0.0])]
    tractions = [fem_snh.Traction(group=g, vector=tuple(turn @ v)) for g, v in loads]
    symmetry = [fem_snh.Symmetry(group=group) for group in CORNER]
    body = turned_cube(comm, element, turn)
    return problem(body, element, features=tractions, symmetry=symmetry, **conditions)


def solved(p):
    with fem_snh._petsc.default_options("symmetry_", {"snes_scaled_tol": 1e-12}):
        snes = solver.create(p, prefix="symmetry_")
        p.set_load(1.0)
        p.prescribe(p.x)
        with solver.callback_errors():
            snes.solve(None, p.x)
    reason = snes.getConvergedReason()
    solver.destroy(snes)
    assert reason > 0, reason
    return p


def assert_turned(first, second, turn, rtol=1e-9):
    """The displacement of the second problem is that of the first, turned."""
    expected = first.nodal(first.x) @ turn.T
    distance, node = cKDTree(first.coordinates @ turn.T).query(second.coordinates)
    assert distance.max(initial=0.0) < 1e-12
    difference = norm(first.comm, second.nodal(second.x) - expected[node])
    assert difference < rtol * norm(first.comm, expected)
    assert norm(first.comm, expected) > 0.1
    assert second.energy(second.x) == pytest.approx(first.energy(first.x), rel=1e-11, abs=1e-14)


# --- an inclined roller is the rotated axis-aligned one --------------------------------------


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["P1", "Q1", "P2", "Q1P0", "P2P1", "Q2Q1"])
def test_inclined_rollers_are_turned_ones(comm, element):
    """Faces, and edges and corners in two and three planes, by the default solver."""
    axes, turned = (solved(loaded(comm, element, turn)) for turn in (np.eye(3), R))
    assert axes.dirichlet.planes is None
    assert_turned(axes, turned, R)


def test_matrix_is_symmetric_and_keeps_its_spectrum():
    matrices = []
    for turn in (np.eye(3), R):
        p = loaded(MPI.COMM_SELF, "Q1", turn)
        set_values(p, lambda X, turn=turn: wave(0.05)(X @ turn) @ turn.T)
        p.dirichlet.project(p.x.array)
        p.matrix.set_constrained_diagonal(2.0)
        p.jacobian(p.x, "clamp")
        matrices.append(dense(p.A))
    assert abs(matrices[1] - matrices[1].T).max() < 1e-14
    values = [np.linalg.eigvalsh(A) for A in matrices]
    assert np.allclose(*values, rtol=1e-10)


@pytest.mark.one_debian
@mpi
def test_reactions_balance_the_loads(comm):
    """The sum of the planes' forces is that of the loads, each along its plane's normal."""
    p = solved(loaded(comm, "Q1", R, reactions=CORNER))
    r = p.x.duplicate()
    p.gradient(p.x, r)
    free = r.copy()
    p.project(free.array)
    held = (r - free).array_r.reshape(-1, 3)
    total = comm.allreduce(held.sum(axis=0))
    assert total == pytest.approx(-(R @ [0.2, -0.15, 0.05]), abs=1e-10)
    axes = solved(loaded(comm, "Q1", np.eye(3), reactions=["left"]))
    left = R @ axes.reactions(axes.x)["left"]
    assert p.reactions(p.x)["left"] == pytest.approx(left, abs=1e-9)


# --- with other conditions -------------------------------------------------------------------


@pytest.mark.one_debian("ranks")
@mpi
def test_a_component_and_a_plane_constrain_together(comm):
    """A plane about the axis z, a motion along x: what the plane leaves of y follows from x."""
    turn = rotation(0, 0, 0.6)
    move = Condition("left", lambda X, load: load * np.tile([0.1, 9, 9], (len(X), 1)), ("x",))
    hold = [Hold("bottom", ("z",))]
    symmetry = [fem_snh.Symmetry(group="left")]
    p = problem(turned_cube(comm, "Q1", turn), "Q1", hold=hold, move=[move], symmetry=symmetry)
    p = solved(p)
    normal = turn[:, 0]
    u, X = p.nodal(p.x), p.coordinates
    on = np.abs(X @ normal) < 1e-12
    assert np.allclose(u[on] @ normal, 0, atol=1e-15)
    assert np.allclose(u[on, 0], 0.1)
    assert np.allclose(u[on, 1], -0.1 * normal[0] / normal[1])
    assert comm.allreduce(int(on.sum())) == 9


@mpi
def test_motions_out_of_a_plane_are_refused(comm):
    move = Condition("top", lambda X, load: load * np.tile([0.3, 0, 0], (len(X), 1)))
    for turn in (np.eye(3), R):
        with pytest.raises(BadInput, match=r"symmetry.group = 'left': expected a plane that no"):
            symmetry = [fem_snh.Symmetry(group="left")]
            problem(turned_cube(comm, "Q1", turn), "Q1", move=[move], symmetry=symmetry)


# --- sectors ---------------------------------------------------------------------------------

SECTOR = """
angle = {angle};
Point(1) = {{1, 0, 0}};
line[] = Extrude {{1, 0, 0}} {{ Point{{1}}; Layers{{3}}; }};
face[] = Extrude {{ {{0, 0, 1}}, {{0, 0, 0}}, angle }} {{
  Line{{line[1]}}; Layers{{{layers}}}; Recombine;
}};
body[] = Extrude {{0, 0, 1}} {{ Surface{{face[1]}}; Layers{{2}}; Recombine; }};
Physical Surface("start") = {{body[2]}}; Physical Surface("end") = {{body[4]}};
Physical Surface("low") = {{face[1]}}; Physical Surface("high") = {{body[0]}};
Physical Surface("inner") = {{body[5]}}; Physical Surface("outer") = {{body[3]}};
Physical Volume("body") = {{body[1]}};
"""
PLANE_GROUPS = """
Physical Curve("start") = {{line[1]}}; Physical Curve("end") = {{face[0]}};
Physical Curve("inner") = {{face[2]}}; Physical Surface("body") = {{face[1]}};
"""


#: What all sectors of the tube have.
TUBE = {
    "name": "sector", "element": "Q1", "pressure": [{"group": "inner", "value": 0.1}],
    "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.4, "density": 1.0},
}  # fmt: skip


def run_sector(comm, folder, angle, layers, **tables):
    """Return the result of a sector of the tube in three dimensions."""
    path = write_msh(comm, folder, SECTOR.format(angle=angle, layers=layers))
    given = {
        "hold": [LOW], "probe": [{"name": "out", "point": [2, 0, 1]}],
        "reactions": ["low", "start"], "petsc": {"snes_scaled_tol": 1e-13},
    }  # fmt: skip
    return run(comm, path, **given | tables)


def run(comm, path, **tables):
    """Return the result of the mesh of a sector."""
    result = solve(scenes.validate(TUBE | {"mesh": path} | tables, "sector"), comm)
    assert result.converged, result.status
    return result


#: A quarter of a tube, whose cuts are coordinate planes, and a sector of it.
LOW, HIGH = ({"group": group, "components": ["z"]} for group in ("low", "high"))
CUTS = [{"group": "start", "components": ["y"]}, {"group": "end", "components": ["x"]}]
QUARTER = {"hold": [LOW, *CUTS]}
PLANES = {"symmetry": [{"group": "start"}, {"group": "end"}]}


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("parts", [3, 6])
def test_a_sector_of_a_tube_is_the_whole(comm, folder, parts):
    whole = run_sector(comm, folder, np.pi / 2, 6, hold=[LOW, HIGH, *CUTS])
    sector = run_sector(comm, folder, np.pi / 2 / parts, 6 // parts, hold=[LOW, HIGH], **PLANES)
    first, second = whole.steps[-1], sector.steps[-1]
    assert second["probes"]["out"] == pytest.approx(first["probes"]["out"], abs=1e-10)
    assert second["volume_ratio"] == pytest.approx(first["volume_ratio"], rel=1e-10)
    one, other = first["reactions"], second["reactions"]
    assert parts * other["low"][2] == pytest.approx(one["low"][2], abs=1e-9)
    # The force along the normal of the cut is the hoop tension, the same for every sector.
    assert other["start"][1] == pytest.approx(one["start"][1], abs=1e-9)


@pytest.mark.one_debian
@mpi
def test_a_plane_sector_has_an_energy(comm, folder):
    """The pressure on a curve between two inclined lines through the centre is conservative."""
    plane = SECTOR[: SECTOR.index("body[]")] + PLANE_GROUPS
    path = write_msh(comm, folder, plane.format(angle=np.pi / 6, layers=2), dim=2)
    found = []
    for tables in (PLANES, {"hold": [CUTS[0]], "symmetry": [{"group": "end"}]}):
        result = run(comm, path, element="Q2", kinematics="plane_strain", **tables)
        found.append(result.steps[-1]["energy"])
    assert found[0] is not None and found[0] == pytest.approx(found[1], rel=1e-12)


@mpi
@pytest.mark.parametrize("integrator", ["backward_euler", "newmark"])
def test_a_sector_in_time(comm, folder, integrator):
    """With damping; prescribed motion on the free end gives velocities to constrained nodes."""
    time = {"duration": 2.0, "steps": 4, "integrator": integrator,
            "damping": {"mass": 0.1, "stiffness": 0.05}}  # fmt: skip
    move = [{"group": "high", "translate": [0, 0, 0.2], "components": ["z"]}]
    tables = {"time": time, "move": move, "fields": ["reaction_force"]}
    whole = run_sector(comm, folder, np.pi / 2, 6, **QUARTER, **tables)
    sector = run_sector(comm, folder, np.pi / 6, 2, **PLANES, **tables)
    for first, second in zip(whole.steps, sector.steps, strict=True):
        assert second["probes"]["out"] == pytest.approx(first["probes"]["out"], abs=1e-9)
        for name in ("kinetic_energy", "elastic_energy", "work", "dissipated"):
            if name in first:
                assert 3 * second[name] == pytest.approx(first[name], rel=1e-7, abs=1e-12)
    assert whole.steps[-1]["probes"]["out"][2] == pytest.approx(0.2)


def test_modes_of_a_sector_are_symmetric_ones_of_the_whole(folder):
    whole, sector = (
        run_sector(MPI.COMM_SELF, folder, *size, **planes, modes={"count": count}, pressure=[])
        for size, planes, count in (((np.pi / 2, 6), QUARTER, 12), ((np.pi / 6, 2), PLANES, 3))
    )
    assert len(sector.frequencies) == 3
    for frequency in sector.frequencies:
        assert abs(np.array(whole.frequencies) / frequency - 1).min() < 1e-9
