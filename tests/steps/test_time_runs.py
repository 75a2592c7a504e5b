"""Runs in time: motions with exact solutions, rows, fields, failed and adaptive steps."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve
from time_scenes import DOWN, SWING, in_time

from fem_snh.scenes import Start
from fem_snh.solver import ProjectedNewton
from fem_snh.viewing.render.surfaces import read_grid

mpi = pytest.mark.mpi
G = 9.81
WEIGHT = np.array([0, 0, -1000 * G])


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("integrator", ["bdf2", "generalized_alpha"])
def test_reactions_are_those_of_the_steps_end(integrator):
    """The balance of generalised-alpha is not at the step's end: its reaction is, to order 2."""
    time = {"duration": 0.2, "steps": 8, "integrator": integrator}
    result = solve(in_time(time, **SWING, reactions=["left"]))
    reaction = np.array(result.steps[-1]["reactions"]["left"])
    if integrator == "bdf2":  # reaction and weight accelerate the body
        force = result.dynamics.mass.apply(result.a.x.array).reshape(-1, 3).sum(axis=0)
        total = result.problem.comm.allreduce(force)
        assert reaction + WEIGHT == pytest.approx(total, abs=1e-3)
    else:
        time |= {"steps": 64, "integrator": "newmark"}
        fine = solve(in_time(time, **SWING, reactions=["left"]))
        assert reaction == pytest.approx(fine.steps[-1]["reactions"]["left"], rel=0.01, abs=5.0)


@mpi
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_reactions_in_files_and_rows_are_the_force_on_the_body(comm, folder, element):
    """At the start, too: Newmark's momentum changes by the mean of both ends' forces.

    The sum over the points of a file is the total on any number of ranks, also where our own
    pictures and exports merge the points.
    """
    import pyvista

    alpha = 0.5
    time = {"duration": 0.1, "steps": 2, "damping": {"mass": alpha, "stiffness": 0.01}}
    start = Start(velocity=(0.1, 0.2, 0.3), angular_velocity=(0, 0, 3.0))
    result = solve(
        in_time(time, **SWING, start=start, element=element, reactions=["left"],
                fields=["reaction_force"], petsc={"snes_scaled_tol": 1e-12}),
        out=folder,
    )  # fmt: skip
    comm.barrier()
    states = [result.record["time"]["start"], *result.steps]
    forces = [np.array(state["reactions"]["left"]) for state in states]
    size = np.linalg.norm(forces, axis=1).max()
    for old, new, *R in zip(states, states[1:], forces, forces[1:], strict=False):
        before, after = np.array(old["momentum"]), np.array(new["momentum"])
        force = (R[0] + R[1]) / 2 - alpha * (before + after) / 2
        assert (after - before) / new["time_step"] == pytest.approx(force + WEIGHT, abs=1e-6 * size)
    reader = pyvista.get_reader(str(folder / "fields.pvd"))
    for number, force in enumerate(forces):
        reader.set_active_time_point(number)
        grid = reader.read().combine()
        found = grid.point_data["reaction_force"]
        assert found.sum(axis=0) == pytest.approx(force, abs=1e-9 * size)
        pieces = [str(folder / f"fields_p{k}_{number:06}.vtu") for k in range(comm.size)]
        merged = read_grid(pieces, None)
        assert merged.n_points == len({tuple(x) for x in grid.points.round(9)})
        assert merged["reaction_force"].sum(axis=0) == pytest.approx(force, abs=1e-9 * size)
        left = merged.points[:, 0] < 1e-9
        assert not merged["reaction_force"][~left].any()
        assert abs(merged["reaction_force"][left]).max(axis=1).min() > 1e-6 * size
    comm.barrier()


@pytest.mark.one_debian("ranks")
@mpi
def test_forces_are_constant_and_tables_are_in_seconds(folder):
    """Without a table gravity acts from the start; with one, as its points in time say."""
    time = {"duration": 2.0, "steps": 4}
    late = [{"name": "late", "points": [[1.0, 0.0], [1.0 + 1e-9, 1.0]]}]
    result = solve(in_time(time, gravity=DOWN))
    assert result.steps[0]["momentum"][2] == pytest.approx(-1000 * G * 0.5, rel=1e-6)
    scene = in_time(time, gravity={"vector": (0, 0, -G), "table": "late"}, table=late)
    momenta = [row["momentum"][2] for row in solve(scene).steps]
    assert momenta[:2] == pytest.approx([0, 0], abs=1e-6)
    assert momenta[2:] == pytest.approx([-0.25e3 * G, -0.75e3 * G], rel=1e-6)


@mpi
def test_a_start_has_velocity_and_angular_velocity(comm):
    """They are those of the body in its initial displacement, about the point ``through``."""
    turned = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
    start = Start(map=turned, through=(0, 0, 0), velocity=(1, 0, 0), angular_velocity=(0, 0, 2.0))
    result = solve(in_time({"duration": 1e-9, "steps": 1}, start=start))
    X = result.problem.V.tabulate_dof_coordinates()
    x = X @ np.array(turned).T
    expected = np.cross([0, 0, 2.0], x) + np.array([1, 0, 0])
    assert result.v.x.array.reshape(-1, 3) == pytest.approx(expected, abs=1e-6)
    # m (v + w x c), and the sum of x x (w x x), of a unit cube in x < 0, y > 0
    assert result.steps[0]["momentum"] == pytest.approx([0, -1000, 0], abs=1e-3)
    spin = 2000 * 2 / 3 - 1000 * 0.5
    assert result.steps[0]["angular_momentum"][2] == pytest.approx(spin, rel=1e-6)


@mpi
def test_a_failed_time_step_is_halved_and_the_nominal_one_returns(comm, monkeypatch):
    """The first solve of the third step gets NaN; the steps before it are as they were."""
    solves = [0]

    def break_third(snes, iteration):
        solves[0] += iteration == 0
        if solves[0] == 3:
            snes.getSolution().set(np.nan)

    scene = in_time({"duration": 0.5, "steps": 5}, **SWING, petsc={"snes_scaled_tol": 1e-12})
    smooth = solve(scene)
    set_from_options = ProjectedNewton.setFromOptions

    def set_update(context, snes):
        set_from_options(context, snes)
        snes.setUpdate(break_third)

    monkeypatch.setattr(ProjectedNewton, "setFromOptions", set_update)
    halved = solve(scene)
    assert [row["converged"] for row in halved.steps] == [True, True, False, True, True, True, True]
    times = [row["time"] for row in halved.steps]
    assert times == pytest.approx([0.1, 0.2, 0.3, 0.25, 0.3, 0.4, 0.5])
    assert [row["kinetic"] for row in halved.steps[:2]] == [r["kinetic"] for r in smooth.steps[:2]]
    assert halved.steps[2]["kinetic"] == pytest.approx(halved.steps[1]["kinetic"], rel=1e-14)
    last = [run.steps[-1]["kinetic"] for run in (halved, smooth)]
    assert last[0] == pytest.approx(last[1], rel=0.02) and last[0] != last[1]


@mpi
def test_adaptive_steps_keep_the_error_below_the_tolerance(comm):
    time = {"duration": 0.4, "steps": 4, "tolerance": 1e-4}
    result = solve(in_time(time, **SWING))
    assert result.converged
    accepted = [row for row in result.steps if row["converged"]]
    assert all(row["error"] <= 1e-4 for row in accepted) and len(accepted) > 4
    rejected = [row for row in result.steps if not row["converged"]]
    assert all(row["reason"] == "ERROR_ABOVE_TOLERANCE" for row in rejected)
    assert {0.1, 0.2, 0.4} <= {round(row["time"], 12) for row in accepted}
    loose = solve(in_time(time | {"tolerance": 1e-2}, **SWING))
    assert len(loose.steps) == 4
    fine = solve(in_time({"duration": 0.4, "steps": 400}, **SWING)).steps[-1]["kinetic"]
    errors = [abs(r.steps[-1]["kinetic"] / fine - 1) for r in (result, loose)]
    assert errors[0] < 0.1 * errors[1]
