"""What holds of a scene with any feature: other units, other numbers of ranks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from features import every_feature, scene_of
from pydantic import BaseModel
from running import solve

#: By a power of two, so that the numbers of one run are multiples of the other's to the last bit.
SCALE = 2.0**20
#: A unit in the description of a key, e.g. "[Pa/m^3]", if it contains that of a force or a mass.
OF_FORCES = re.compile(r"\[(Pa|N|kg)\b")
#: Keys of numbers that are those of the unit, and of some that do not depend on it.
SCALED = ("energy", "kinetic", "elastic", "momentum", "work", "force", "residual", "tolerance")
SAME = ("newton", "linear", "volume_ratio", "load", "penetration", "pose", "solves", "clamped")
ENERGIES = ("energy", "kinetic", "elastic", "potential")
#: Features whose error is estimated as well.
ESTIMATED = ("cell pressures", "traction", "contact", "cavity", "axisymmetric")


def in_other_units(table: Any, scale: float = 1.0) -> Any:
    """Return a table of a scene with all forces, stresses and masses times SCALE."""
    if isinstance(table, (list, tuple)):
        return type(table)(in_other_units(item, scale) for item in table)
    if isinstance(table, BaseModel):
        fields = type(table).model_fields
        scales = {k: SCALE if OF_FORCES.search(fields[k].description or "") else 1 for k in fields}
        update = {key: in_other_units(getattr(table, key), scales[key]) for key in fields}
        return table.model_copy(update=update)
    return table * scale if isinstance(table, float) else table


def numbers(row: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a row with their keys."""
    if isinstance(row, dict):
        for key, value in row.items():
            yield from numbers(value, f"{name}.{key}")
    elif isinstance(row, (list, tuple, np.ndarray)):
        for value in row:
            yield from numbers(value, name)
    elif isinstance(row, (int, float)) and not name.endswith("seconds"):
        yield name, float(row)


@every_feature
def test_in_other_units_every_number_is_the_same_or_a_multiple(case):
    """Whatever iterates takes the same iterations: nothing is compared with a force of its own."""
    scene = scene_of(case).model_copy(update={"error": case in ESTIMATED})
    found, other = (solve(given) for given in (scene, in_other_units(scene)))
    pairs = zip(found.steps, other.steps, strict=True)
    compared = [*pairs, *((found.goals[name], other.goals[name]) for name in found.goals)]
    assert found.converged and bool(found.goals) == (case in ESTIMATED)
    for one, two in compared:
        for (key, a), (_, b) in zip(numbers(one), numbers(two), strict=True):
            last = key.rpartition(".")[2]
            factors = {SCALE} if last in SCALED else {1} if last in SAME else {1, SCALE}
            assert b in (factor * a for factor in factors) or np.isnan([a, b]).all(), (key, a, b)


@pytest.mark.one_debian("serial")
@pytest.mark.mpi
@every_feature
def test_any_number_of_ranks_gives_the_same_state(case):
    """Each rank by itself, and all together: energies, volumes and forces of every step."""
    scene = scene_of(case)
    tight = {"snes_scaled_tol": 1e-12} | ({"ksp_rtol": 1e-11} if case == "linearised" else {})
    scene = scene.model_copy(update={"petsc": scene.petsc | tight})
    alone, together = (solve(scene, comm=comm) for comm in (MPI.COMM_SELF, MPI.COMM_WORLD))
    for one, two in zip(alone.steps, together.steps, strict=True):
        assert two["load"] == one["load"] and two["converged"] == one["converged"]
        if one["converged"]:
            size = max(abs(one.get(key) or 0) for key in ENERGIES)
            for key in ENERGIES:
                assert (two.get(key) or 0) == pytest.approx(one.get(key) or 0, abs=1e-6 * size)
            assert two["volume_ratio"] == pytest.approx(one["volume_ratio"], rel=1e-7)
            forces = [
                np.array([value for key, value in numbers(row) if key.endswith(".force")])
                for row in (one, two)
            ]
            largest = abs(forces[0]).max(initial=0.0)
            np.testing.assert_allclose(*forces, atol=1e-5 * largest)
