"""Forces on groups: an exact solution, balance, tables, ranks; the scene pull."""

from __future__ import annotations

import csv

from mpi4py import MPI

import numpy as np
import pytest

import fem_snh

mpi = pytest.mark.mpi
TIGHT = {"snes_scaled_tol": 1e-11, "ksp_rtol": 1e-9, "snes_forcing_max": 0}


def solve(scene="pull", comm=MPI.COMM_WORLD, **kwargs):
    return fem_snh.run(scene, comm=comm, progress=False, **kwargs)


@pytest.mark.one_debian("ranks")
@mpi
def test_pull_balances_and_each_node_counts_once(comm):
    """What pulls on the right holds on the left; the whole surface and the whole body balance."""
    result = solve(cells=3, steps=2, reactions=["right", "left", "body"], petsc=TIGHT)
    for step in result.steps:
        forces = step["reactions"]
        assert list(forces) == ["right", "left", "body"]
        assert forces["right"][0] > 0.3 * step["load"]
        assert forces["right"] == pytest.approx(-np.array(forces["left"]), abs=1e-9)
        assert forces["body"] == pytest.approx([0, 0, 0], abs=1e-9)
        assert forces["right"][1:] == pytest.approx([0, 0], abs=1e-9)


@pytest.mark.one_debian
@mpi
def test_the_force_is_the_derivative_of_the_energy(comm):
    """dE/d(distance), by central differences of converged energies."""
    h = 1e-3
    energies = [
        solve(cells=3, steps=1, stretch=s, petsc=TIGHT).steps[-1]["energy"]
        for s in (1.3 - h, 1.3 + h)
    ]
    force = solve(cells=3, steps=1, stretch=1.3, petsc=TIGHT).steps[-1]["reactions"]["right"][0]
    assert force == pytest.approx((energies[1] - energies[0]) / (2 * h), rel=1e-5)


@mpi
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_the_moment_is_the_derivative_of_the_energy_by_the_angle(comm, folder, element):
    """The torque of a turned face, its balance, other points, the table and the goals."""
    about, other = (0.5, 0.5, 0.5), (2.0, -1.0, 0.3)

    def turned(angle, **kwargs):
        kwargs = {"cells": 2, "steps": 1, "element": element, "petsc": TIGHT} | kwargs
        return solve("twist", comm=comm, angle=angle, **kwargs)

    reactions = [{"group": "top", "about": about}, {"group": "bottom", "about": about}, "left"]
    # A single step of no goal is a step of all: the estimate is of the same state.
    result = turned(0.6, reactions=reactions, out=folder, **{"accuracy.goals": "top.moment.z"})
    (step,) = result.steps
    assert set(step["moments"]) == {"top", "bottom"}
    h = 1e-3
    energies = [turned(0.6 + s * h).steps[-1]["energy"] for s in (-1, 1)]
    top, bottom = (np.array(step["moments"][name]) for name in ("top", "bottom"))
    assert top[2] == pytest.approx((energies[1] - energies[0]) / (2 * h), rel=1e-5)
    assert bottom == pytest.approx(-top, abs=1e-8 * top[2])
    moved = turned(0.6, reactions=[{"group": "top", "about": other}]).steps[-1]
    force = np.array(step["reactions"]["top"])
    shift = np.cross(np.subtract(about, other), force)
    assert moved["moments"]["top"] == pytest.approx(top + shift, abs=1e-8 * top[2])
    goal = result.goals["top.moment.z"]
    assert goal["value"] == pytest.approx(top[2], rel=1e-12)
    assert goal["error"] < 0 and 0.01 < goal["relative"] < 0.5  # coarse elements are too stiff
    comm.barrier()
    with (folder / "steps.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert [float(row[f"top.moment.{axis}"]) for axis in "xyz"] == step["moments"]["top"]
    assert float(row["top.moment.z.error"]) == goal["error"]
    comm.barrier()


@pytest.mark.one_debian
@pytest.mark.parametrize("alpha", [0.5, 1.5])
def test_nonlinearity_shows_in_large_strain_only(alpha):
    """Chen & Barbič's Figure 3: the curves part company, and agree where they begin."""
    small = {"cells": 2, "steps": 1, "stretch": 1.001, "petsc": TIGHT}
    large = {"cells": 2, "steps": 4, "stretch": 1.6}

    def force(setup, **more):
        return solve(**setup, **more).steps[-1]["reactions"]["right"][0]

    tuned = {"material.alpha": alpha}
    assert force(small, **tuned) == pytest.approx(force(small), rel=3e-3)
    ratio = force(large, **tuned) / force(large)
    assert ratio > 1.1 if alpha > 1 else ratio < 0.9
