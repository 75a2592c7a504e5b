"""Notes on the terminal, in run.json, in rows and in sweeps; inverted points; jumps."""

from __future__ import annotations

import itertools
import warnings

from mpi4py import MPI

import numpy as np
import pytest
from gmsh_files import write_msh
from interrupted_runs import cut
from note_scenes import arch, bushing, cube
from running import record, rows, solve
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from time_scenes import DOWN, in_time

import fem_snh
from fem_snh.contact.obstacle import Obstacle
from fem_snh.errors import ResultNote
from fem_snh.problem.state_notes import inversion_note
from fem_snh.scenes import MaterialChoice, Scene, Start

mpi = pytest.mark.mpi

# --- inverted points ------------------------------------------------------------------------------

#: Gauss points of the cube, and a corner that is moved beyond the centre.
GAUSS = np.array(list(itertools.product([0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5], repeat=3)))
PUSHED = np.array([-0.8, -0.8, -0.8])


def trilinear_J():
    """J at the Gauss points of a unit cube whose corner (1, 1, 1) is displaced, by hand.

    u = d xyz, so F = I + d (yz, xz, xy) and J = 1 + d . (yz, xz, xy).
    """
    x, y, z = GAUSS.T
    return 1 + np.stack([y * z, x * z, x * y], axis=1) @ PUSHED


def test_inverted_points_are_counted():
    J = trilinear_J()
    assert 0 < (J <= 0).sum() < 8

    def push(X):
        return X.prod(axis=1)[:, None] * PUSHED

    note = inversion_note(cube(MPI.COMM_SELF, 1, "Q1", 0.4, push), 3)
    assert note.step == 3 and note.values["points"] == (J <= 0).sum() and note.values["cells"] == 1
    assert note.values["min_J"] == pytest.approx(J.min(), rel=1e-12)
    assert note.values["min_cell_J"] == pytest.approx(J.mean(), rel=1e-12)
    assert note.values["position"] == pytest.approx([0.5] * 3)
    assert f"{(J <= 0).sum()} of 8 quadrature points are inverted" in note.text


@mpi
def test_the_place_of_the_worst_point_is_that_of_any_number_of_ranks(comm):
    def fold(X):
        return np.stack([0 * X[:, 0], 0 * X[:, 0], -1.5 * X[:, 2] ** 8 * X[:, 0]], axis=1)

    here, alone = (inversion_note(cube(c, 4, "Q1", 0.4, fold)) for c in (comm, MPI.COMM_SELF))
    for key in ("points", "cells"):
        assert here.values[key] == alone.values[key] > 0
    assert here.values["min_J"] == pytest.approx(alone.values["min_J"], rel=1e-12)
    assert here.values["position"][::2] == pytest.approx([0.875, 0.875])


TURNED = "rotate = { axis = [1, 0, 0], through = [0, 0, 0.015], angle = 0.5 }"


@pytest.mark.one_debian
def test_a_bushing_that_is_tilted(tmp_path, capsys):
    """Means over cells near 1, while points are inverted: the row and the note say both."""
    path = bushing(MPI.COMM_SELF, tmp_path, "P2P0", 0.499, motion=TURNED)
    result = fem_snh.run(path, comm=MPI.COMM_SELF, out=tmp_path / "out")
    last, lines = result.steps[-1], capsys.readouterr().out.splitlines()
    assert result.converged and last["min_J"] < 0 < 0.9 < last["min_cell_J"]
    assert last["notes"] == ["inverted"]
    (note,) = [note for note in result.notes if note["kind"] == "inverted"]
    assert note["min_J"] == pytest.approx(last["min_J"], rel=1e-9)
    assert note["min_cell_J"] == pytest.approx(last["min_cell_J"], rel=1e-9)
    assert record(tmp_path / "out")["notes"] == result.notes
    assert rows(tmp_path / "out")[-1]["notes"] == "inverted"
    step = [line for line in lines if "load 1.0000" in line][-1]
    assert " ok, inverted " in step and f"(cell means {last['min_cell_J']:.3f})" in step
    count = f"{len(result.notes)} note"
    assert any(line.startswith(f"  converged, {count}") for line in lines)
    assert f"  note: {note['text']}" in lines


def test_a_step_that_inverts_points_is_followed_in_halves(tmp_path):
    """A block that is pressed to a fifth of its height: only in one step its points invert."""
    keys = {"cells": 2, "element": "Q2", "nu": 0.45, "stretch": 0.2, "predictor": "tangent"}
    keys["petsc"] = {"snes_linear_solver": "direct"}
    one, two = (
        solve("pull", MPI.COMM_SELF, steps=n, out=tmp_path / str(n), **keys) for n in (1, 2)
    )
    assert [(row["load"], row["converged"]) for row in one.steps] == [
        (1.0, False), (0.5, True), (1.0, True)
    ]  # fmt: skip
    assert one.steps[0]["reason"].startswith("INVERTED: min J = -0.")
    for ours, theirs in zip(one.steps[1:], two.steps, strict=True):
        assert ours["energy"] == pytest.approx(theirs["energy"], rel=1e-6)
        assert ours["min_J"] > 0
    assert rows(tmp_path / "1")[0]["lbfgs"] == str(one.steps[0]["lbfgs"])


def test_iterations_of_every_kind_are_printed_and_in_the_row(capsys):
    """Two thousand L-BFGS iterations were in no line, those that examine a step in no row."""
    result = fem_snh.run("scramble", cells=4, comm=MPI.COMM_SELF)
    (row,), lines = result.steps, capsys.readouterr().out.splitlines()
    assert row["lbfgs"] > 0 and any(f" {row['lbfgs']} L-BFGS, " in line for line in lines)
    result = fem_snh.run("twist", cells=3, steps=2, angle=np.pi, comm=MPI.COMM_SELF)
    row, lines = result.steps[-1], capsys.readouterr().out.splitlines()
    assert row["examined_newton"] >= 4 and row["examined_linear"] > row["examined_newton"]
    assert any(f" {row['examined_newton']} Newton to examine it, " in line for line in lines)


# --- jumps ----------------------------------------------------------------------------------------


@pytest.mark.one_debian
@pytest.mark.parametrize("steps", [2, 5])
def test_an_arch_snaps_through(tmp_path, steps):
    """Its limit load is where a fine stepping jumps; before and after, nothing is said."""
    paths = [tmp_path / str(n) for n in (steps, 40)]
    found = []
    for path, n in zip(paths, (steps, 40), strict=True):
        path.mkdir()
        result = solve(arch(MPI.COMM_SELF, path, n, -40.0), comm=MPI.COMM_SELF)
        assert result.converged
        (note,) = [note for note in result.notes if note["kind"] == "jump"]
        row = result.steps[note["step"]]
        assert row["notes"] == ["jump"] and sum("notes" in row for row in result.steps) == 1
        before, after = (result.steps[note["step"] - i]["probes"]["middle"][2] for i in (1, 0))
        assert before > -0.02 and after < -0.09  # from above the supports to below them
        assert note["part"] > 0.8
        found.append((note["start"], note["end"]))
    (start, end), (fine_start, fine_end) = found
    assert start <= fine_start < fine_end <= end


SHELL = """
Point(1) = {0, 0, 0};
For k In {0:1}
  Point(10+k) = {10+k, 0, 0}; Point(20+k) = {0, 10+k, 0}; Circle(k+1) = {10+k, 1, 20+k};
EndFor
Line(3) = {10, 11}; Line(4) = {20, 21};
Curve Loop(1) = {1, 4, -2, -3}; Plane Surface(1) = {1};
Transfinite Curve{1, 2} = 7; Transfinite Curve{3, 4} = 2;
Transfinite Surface{1} = {10, 20, 21, 11}; Recombine Surface{1};
Physical Surface("body") = {1}; Physical Curve("inside") = {1}; Physical Curve("equator") = {3};
"""


def limit_pressure(C10, C01, ratio):
    """Return the largest pressure of an incompressible spherical shell (Green & Zerna, 3.10)."""

    def pressure(a):
        b = np.cbrt(1 + (a**3 - 1) / ratio**3)
        return quad(lambda s: slope(s) / (s**3 - 1), b, a)[0]

    def slope(s):
        return C10 * (4 * s - 4 * s**-5) + C01 * (4 * s**3 - 4 * s**-3)

    return -minimize_scalar(lambda a: -pressure(a), bounds=(1.05, 1.8), method="bounded").fun


@mpi
def test_a_balloon_jumps_at_its_limit_pressure(comm, folder):
    """It went from a stretch of 1.3 to one of 5.9 in one step, without a word."""
    limit = limit_pressure(0.4, 0.04, 1.1)
    scene = {
        "name": "balloon", "mesh": write_msh(comm, folder, SHELL, dim=2), "element": "Q2Q1",
        "kinematics": "axisymmetric", "steps": 8,
        "material": {"name": "mooney_rivlin", "C10": 0.4, "C01": 0.04, "D1": 0.0},
        "hold": [{"group": "equator", "components": ["y"]}],
        "pressure": [{"group": "inside", "value": limit / 0.95}],
    }  # fmt: skip
    result = solve(Scene.model_validate(scene), comm)
    (note,) = [note for note in result.notes if note["kind"] == "jump"]
    assert note["start"] < 0.95 < note["end"] and note["ratio"] > 10
    assert note["part"] > 0.8 and result.steps[note["step"]]["load"] == 1.0
    assert "the volume of a [[cavity]] in place of a pressure" in note["text"]


def test_steps_with_contact_are_noted_if_they_jump(tmp_path):
    """They are not solved again: an arch snaps through above a floor that is far away."""
    path = arch(MPI.COMM_SELF, tmp_path, 5, -40.0)
    floor = '[[obstacle]]\nname = "floor"\nshape = { plane = { point = [0, 0, -9] } }\n'
    path.write_text(path.read_text() + floor)
    (note,) = solve(path, MPI.COMM_SELF).notes
    assert note["kind"] == "jump" and note["step"] == 2 and note["ratio"] > 10
    assert "times as far as expected in" in note["text"] and "are not examined" in note["text"]


@pytest.mark.one_debian
@pytest.mark.parametrize(("rise", "hold", "pressure"), [(0.06, "ends", 40.0), (0.0, "left", 4.0)])
def test_large_motions_along_a_path_are_no_jumps(tmp_path, rise, hold, pressure):
    """An arch under tension, and a cantilever that bends by a third of its length."""
    result = solve(arch(MPI.COMM_SELF, tmp_path, 3, pressure, rise, hold), comm=MPI.COMM_SELF)
    assert result.converged and not result.notes
    assert abs(result.steps[-1]["probes"]["middle"][2]) > 0.01


SQUARE = """
Point(1) = {0, 0, 0};
side[] = Extrude {1, 0, 0} { Point{1}; Layers{4}; };
base[] = Extrude {0, 1, 0} { Line{side[1]}; Layers{4}; Recombine; };
Physical Surface("body") = {base[1]}; Physical Curve("bottom") = {side[1]};
Physical Curve("top") = {base[0]}; Physical Curve("left") = {base[3]};
"""


@pytest.mark.one_debian
@mpi
def test_one_step_through_a_bifurcation(comm, folder):
    """A square that is pressed to a tenth of its height: the uniform state is stable as well.

    It is reached in one step only, and has twice the energy of the one that 20 steps reach.
    """
    mesh = write_msh(comm, folder, SQUARE, dim=2)
    scene = {
        "name": "square", "mesh": mesh, "element": "Q1", "kinematics": "plane_stress",
        "material": {"name": "mooney_rivlin", "E": 1.0, "nu": 0.3},
        "hold": [{"group": "bottom", "components": ["y"]}],
        "move": [{"group": "top", "translate": [0, -0.9, 0], "components": ["y"]}],
        "symmetry": [{"group": "left"}],
    }  # fmt: skip
    one, several = (
        solve(Scene.model_validate(scene | {"steps": steps}), comm) for steps in (1, 20)
    )
    (note,) = one.notes
    energy = one.steps[-1]["energy"]
    assert note["kind"] == "jump" and one.steps[-1]["notes"] == ["jump"]
    assert note["energy"] == pytest.approx(energy, rel=1e-9)
    assert several.steps[-1]["energy"] < 0.7 * energy
    assert note["followed"] == pytest.approx(several.steps[-1]["energy"], rel=0.1)
    assert "than 4 smaller ones" in note["text"] and "take more steps" in note["text"]


def test_rest_under_load_is_no_jump():
    """A pressure leaves an incompressible cube at rest, to tolerances."""
    rollers = [{"group": group} for group in ("left", "front", "bottom")]
    scene = {
        "name": "rivlin", "mesh": {"source": "cube"}, "cells": 2, "element": "Q2Q1", "steps": 3,
        "material": {"name": "neo_hookean", "E": 3.0, "nu": 0.5}, "symmetry": rollers,
        "traction": [
            {"group": group, "vector": [0.3 * (i == axis) for i in range(3)]}
            for axis, group in enumerate(("right", "back", "top"))
        ],
    }  # fmt: skip
    result = solve(Scene.model_validate(scene), MPI.COMM_SELF)
    assert result.steps[-1]["max_u"] < 1e-6 and not result.notes


# --- records --------------------------------------------------------------------------------------


def jumping(folder):
    return {"scene": arch(MPI.COMM_SELF, folder, 4, -40.0)}


def locking(folder):
    return {"scene": "cook", "element": "Q1", "cells": 2, "nu": 0.499}


@pytest.mark.parametrize("make", [jumping, locking])
def test_a_resumed_run_has_the_notes_of_a_whole_one(tmp_path, make):
    """Of a step before the interruption, and of the last state; also when it has finished."""
    values = make(tmp_path) | {"comm": MPI.COMM_SELF}
    whole, out = solve(**values), tmp_path / "out"
    with cut(3):
        solve(out=out, **values)
    resumed, again = (solve(out=out, resume=True, **values) for _ in range(2))
    assert len(whole.notes) == 1
    assert [note["text"] for note in resumed.notes] == [note["text"] for note in whole.notes]
    assert again.notes == resumed.notes


# --- programs -------------------------------------------------------------------------------------


@mpi
def test_a_program_has_notes_and_one_warning_of_a_kind(comm):
    """A cube of few cells that is pressed, at two Poisson's ratios."""
    import ufl
    from dolfinx_programs import Press, converged, unit_cube

    for nu, kinds in ((0.3, []), (0.4999, ["locking"])):
        press = Press(unit_cube(comm), height=-0.1)
        material = fem_snh.material("stable_neo_hookean", E=1.0, nu=nu)
        problem = fem_snh.NonlinearProblem(press.u, {material: ufl.dx}, bcs=press.bcs)
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            for _ in range(2):
                problem.solve()
        assert converged(problem) and [note.kind for note in problem.notes] == kinds
        warned = [w for w in seen if w.category is ResultNote]
        assert len(warned) == (len(kinds) if comm.rank == 0 else 0)
        for note in problem.notes:
            assert "element = 'Q1' locks" in note.text


def test_more_than_half_a_turn_in_a_step_is_said():
    """A whole turn in one step ends at the body's rest, which is no wound body."""
    whole = solve("twist", cells=1, steps=1, angle=2 * np.pi)
    assert whole.converged and whole.steps[-1]["energy"] == pytest.approx(0, abs=1e-9)
    (note,) = [note for note in whole.notes if "rotate turns by" in note["text"]]
    assert "turns by 360 degrees in 1 step," in note["text"] and "at least 2 steps" in note["text"]
    half = solve("twist", cells=1, steps=1, angle=np.pi)
    assert not [note for note in half.notes if "rotate turns by" in note["text"]]


@pytest.mark.parametrize(
    ("axis", "components", "left"),
    [
        ([0, 0, 1], ["x", "y"], ""), ([0, 0, 1], ["y", "z"], "x"), ([0, 2, 0], ["z"], "x"),
        ([0, 1, 1], ["x"], "y, z"),
    ],
)  # fmt: skip
def test_a_rotation_of_some_components_is_said(axis, components, left):
    """A component that is free, and in which the rotation moves points, decides their angle."""
    scene = {
        "name": "turned", "mesh": {"source": "cube"}, "cells": 1, "element": "Q1",
        "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        "hold": [{"group": "bottom"}],
        "move": [
            {"group": "top", "rotate": {"axis": axis, "angle": 0.2}, "components": components}
        ],
    }  # fmt: skip
    result = solve(Scene.model_validate(scene), MPI.COMM_SELF)
    texts = [note["text"] for note in result.notes if note["kind"] == "load"]
    assert len(texts) == bool(left)
    assert all(f"move.0.rotate moves points along {left} too" in text for text in texts)


@pytest.mark.one_debian
@pytest.mark.parametrize(
    ("integrator", "friction"),
    [("generalized_alpha", 0), ("newmark", 0.3), ("newmark", 0), ("bdf2", 0)],
)
def test_a_motion_that_gains_energy(integrator, friction):
    """The block rocks: forces of a step's start act in part of it, also where contact ends.

    Its energy is nearly doubled within 12 steps. Newmark's method has the mean force of contact.
    """
    floor = {"name": "floor", "shape": {"plane": {}}, "friction": friction}
    tables = {
        "cells": 1,
        "material": MaterialChoice(name="stable_neo_hookean", E=1e6, nu=0.3, density=1000.0),
        "gravity": DOWN,
        "start": Start(velocity=(1, 0, 0), angular_velocity=(0, 1, 0)),
        "obstacle": [Obstacle.model_validate(floor)],
    }
    time = {"duration": 1.2, "steps": 12, "integrator": integrator}
    result = solve(in_time(time, **tables), MPI.COMM_SELF)
    notes = [note for note in result.notes if note["kind"] == "energy"]
    assert len(notes) == (integrator == "generalized_alpha")
    for note in notes:
        row = result.steps[note["step"]]
        start = 500 + 500 / 6  # of the translation, and of the rotation about the centre
        assert note["gained"] == pytest.approx(row["energy"] - start, rel=1e-6)
        assert f"the energy rises by {note['gained']:.3g} J that no load gives" in note["text"]
