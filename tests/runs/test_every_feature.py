"""What holds of a scene with any feature: other units, other axes, other numbers of ranks."""

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

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.mesh import mesh as meshes
from fem_snh.scenes import Geometry

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


@pytest.mark.one_debian
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


def turned(table: Any) -> Any:
    """Return a table of a scene with x, y and z renamed to y, z and x."""
    if isinstance(table, BaseModel):
        update = {key: turned(getattr(table, key)) for key in type(table).model_fields}
        return table.model_copy(update=update)
    if isinstance(table, (list, tuple)):
        if len(table) == 3 and all(isinstance(number, (int, float)) for number in table):
            return type(table)((table[2], table[0], table[1]))
        return type(table)(turned(item) for item in table)
    return {"x": "y", "y": "z", "z": "x"}[table] if table in ("x", "y", "z") else table


def vectors(row: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield the vectors (3,) of a row, and poses (3, 4), with their keys."""
    if isinstance(row, dict):
        for key, value in row.items():
            yield from vectors(value, f"{name}.{key}")
    elif isinstance(row, (list, tuple)) and len(row) == 3:
        yield name, np.array(row, float)


@pytest.mark.one_debian
@every_feature
def test_with_other_names_of_the_axes_every_vector_is_turned(case, tmp_path):
    """Of a body that is turned by 120 degrees about (1, 1, 1), with all that acts on it."""
    scene = scene_of(case)
    if scene.kinematics or case == "cavity":
        pytest.skip("a section, and cells of 27 nodes, which no XDMF file of dolfinx holds")
    scene = scene.model_copy(update={"petsc": scene.petsc | {"snes_scaled_tol": 1e-12}})
    other = turned(scene)
    if isinstance(scene.mesh, Geometry):
        cell, made = ELEMENTS[scene.element].cell, scene.mesh
        body = meshes.generate(
            MPI.COMM_SELF, made.source, cell, cells=scene.cells, **made.parameters
        )
        X = _dolfinx.geometry_x(body.domain)
        X[:] = X[:, [2, 0, 1]].copy()
        meshes.write_xdmf(body, tmp_path / "turned.xdmf")
        other = other.model_copy(update={"mesh": tmp_path / "turned.xdmf", "cells": None})
    for one, two in zip(solve(scene).steps, solve(other).steps, strict=True):
        size = max(abs(one.get(key) or 0) for key in ENERGIES)
        for key in ENERGIES:
            assert (two.get(key) or 0) == pytest.approx(one.get(key) or 0, abs=1e-6 * size), key
        assert two["volume_ratio"] == pytest.approx(one["volume_ratio"], rel=1e-7)
        found = dict(vectors(two))
        for key, vector in vectors(one):
            expected = vector[[2, 0, 1]]
            if vector.ndim == 2:
                expected = expected[:, [2, 0, 1, 3]]
            atol = 1e-5 * max(abs(vector).max(), 1e-9)
            np.testing.assert_allclose(found[key], expected, rtol=0, atol=atol)


@pytest.mark.one_debian
@pytest.mark.mpi(serially=False)
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


@pytest.mark.one_debian
@every_feature
def test_a_scene_is_a_program(case):
    """The program that a scene builds takes the same steps."""
    scene = scene_of(case)
    adaptive = scene.time and scene.time.tolerance
    if scene.start or scene.nu_continuation or scene.predictor == "tangent" or adaptive:
        pytest.skip("its steps are not those of a program, or it starts in a given state")
    made_by = fem_snh.DynamicProblem if scene.time else fem_snh.NonlinearProblem
    program = made_by(**scene.build(MPI.COMM_SELF).arguments)
    rows = list(program.steps(scene.time.steps if scene.time else scene.steps))
    for row, step in zip(rows, solve(scene, comm=MPI.COMM_SELF).steps, strict=True):
        assert row["reason"] == step["reason"]
        known = {key: step[key] for key in row}  # a run has reactions, probes and bones as well
        sizes: dict[str, float] = {}  # of vectors, by the largest component
        for key, b in numbers(known):
            sizes[key] = max(1.0, abs(b), sizes.get(key, 0.0))
        for (key, a), (_, b) in zip(numbers(row), numbers(known), strict=True):
            if not key.endswith("residual"):
                assert a == pytest.approx(b, rel=1e-9, abs=1e-12 * sizes[key]), key
