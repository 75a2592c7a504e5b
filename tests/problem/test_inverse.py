"""Scenes fitted to curves: derivatives by the adjoint, and parameters that are found again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import fem_snh
from fem_snh import cli, scenes
from fem_snh.runs.inverse import InverseProblem, MeasuredCurve, fit_scene

GOALS = ["right.force.x", "volume"]
SMALL: dict[str, Any] = {"cells": 2, "steps": 2}


def measure(**overrides: Any) -> MeasuredCurve:
    """Return force and volume of the pulled cube at half and all of its stretch."""
    record = fem_snh.run("pull", progress=False, **SMALL, **overrides).record
    rows = [step for step in record["steps"] if step["converged"] and step["load"] in (0.5, 1)]
    values = [[row["reactions"]["right"][0], row["volume_ratio"]] for row in rows]
    loads = np.array([0.5, 1])
    return MeasuredCurve("load", loads, loads, GOALS, np.array(values))


def largest_difference(inverse: InverseProblem, step: float = 1e-3) -> float:
    """Return the largest difference of the Jacobian from central differences of runs."""
    z = inverse.start
    _, jacobian = inverse.evaluate(z)
    columns = []
    for direction in np.eye(len(z)):
        ends = [inverse.evaluate(z + sign * step * direction)[0] for sign in (1, -1, 2, -2)]
        one, two = ends[0] - ends[1], ends[2] - ends[3]
        columns.append((8 * one - two) / (12 * step))  # of fourth order
    exact = np.array(columns).T
    return float(np.abs(jacobian - exact).max() / np.abs(exact).max())


@pytest.mark.one_debian
@pytest.mark.mpi
def test_derivatives_are_those_of_differences() -> None:
    """Force and volume by E and nu of a nonlinear scene; 1e-5 is asked for."""
    curve = measure(nu=0.4)
    scene = scenes.load("pull", nu=0.3, **SMALL)
    inverse = InverseProblem(MPI.COMM_WORLD, scene, curve, ["E", "nu"])
    assert largest_difference(inverse) < 1e-6


@pytest.mark.mpi
def test_two_parameters_are_found_again() -> None:
    curve = measure(E=2.0, nu=0.39)
    found = fit_scene("pull", curve, ["E", "nu"], **SMALL)
    assert found.converged and found.solves <= 12
    assert found.parameters["E"] == pytest.approx(2, rel=1e-5)
    assert found.parameters["nu"] == pytest.approx(0.39, rel=1e-5)
    assert found.material["E"] == found.parameters["E"]


@pytest.mark.mpi
def test_goals_in_other_units_give_the_same_fit() -> None:
    """Forces and volume ratios were summed as they are: nu was 0.4004, 0.4040 and 0.4084."""
    curve = measure(nu=0.4)
    noise = np.array([[1.03, 1.0], [0.98, 1.0]]), np.array([[0, 1e-3], [0, -2e-3]])
    found = []
    for unit in (1e-4, 1.0, 1e4):
        values = (curve.values * noise[0] + noise[1]) * [unit, 1.0]
        measured = MeasuredCurve("load", curve.x, curve.loads, GOALS, values)
        f = fit_scene("pull", measured, ["E", "nu"], E=0.8 * unit, nu=0.45, **SMALL)
        assert f.converged
        numbers = [f.parameters["E"] / unit, f.errors["E"] / unit, f.parameters["nu"]]
        found.append([*numbers, f.errors["nu"], *f.r_squared.values()])
    assert found[0] == pytest.approx(found[1], rel=1e-6) == found[2]


@pytest.mark.one_debian
def test_derivatives_with_a_pressure_and_an_obstacle() -> None:
    """Taylor-Hood's unit of pressure and the contact's stiffness depend on E."""
    scene = scenes.load("press", cells=1, steps=1, to=0.8, element="P2P1")
    goals = ["bottom.force.z", "plate.force.z"]
    curve = MeasuredCurve("load", np.ones(1), np.ones(1), goals, np.ones((1, 2)))
    inverse = InverseProblem(MPI.COMM_WORLD, scene, curve, ["E", "nu"])
    assert largest_difference(inverse) < 1e-5


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A distance in the scene's units, and a force that is proportional to E."""
    curve = measure(E=3.0)
    half, whole = curve.values[:, 0].tolist()
    text = f"distance,right.force.x\n1.5,{half!r}\n2.0,{whole!r}\n"
    (tmp_path / "curve.csv").write_text(text)
    words = ["fit", "pull", "--to", str(tmp_path / "curve.csv"), "--parameters", "E",
             "--set", "cells=2", "--set", "steps=2", "--out", str(tmp_path / "out")]  # fmt: skip
    assert cli.main(words) == 0
    record = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert record["parameters"]["E"] == pytest.approx(3, rel=1e-5)
    assert record["loads"] == [0.5, 1]
    assert 'name = "stable_neo_hookean"' in (tmp_path / "out" / "material.toml").read_text()
    assert (tmp_path / "out" / "fit.png").exists()
    printed = capsys.readouterr().out
    assert "converged" in printed and "right.force.x" in printed
    assert record["r_squared"] == {"right.force.x": pytest.approx(1)}
