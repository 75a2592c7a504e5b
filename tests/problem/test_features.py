"""Loads as objects of a dolfinx program: the numbers of the scene with the same tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import tagged_measure, unit_cube, vector_space

import fem_snh
from fem_snh.scenes import Scene

pytestmark = pytest.mark.mpi
TIGHT = {"snes_scaled_tol": 1e-11, "ksp_rtol": 1e-10}
CUBE: dict[str, Any] = {
    "name": "cube",
    "mesh": {"source": "cube"},
    "cells": 2,
    "element": "Q1",
    "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.4, "density": 2.0},
    "hold": [{"group": "bottom"}],
    "petsc": TIGHT,
}
SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.4)
RISE = {"name": "rise", "points": [[0, 0], [0.5, 0.1], [1, 0.5]]}
#: Groups of the scene, which have these numbers in the program.
GROUPS = {"right": 1, "top": 2}
#: Tables of the scene, and the classes of the same keys of a program.
FEATURES = {
    "traction": fem_snh.Traction, "gravity": fem_snh.Gravity, "pressure": fem_snh.Pressure,
    "spring": fem_snh.Spring, "obstacle": fem_snh.Obstacle,
}  # fmt: skip


def rise(x: float) -> float:
    return float(np.interp(x, [0, 0.5, 1], [0, 0.1, 0.5]))


def faces(domain: Any) -> Any:
    """The measure ds with the numbers of GROUPS."""
    return tagged_measure("ds", domain, [lambda x, i=i: np.isclose(x[i], 1.0) for i in (0, 2)])


def bottom(V: Any) -> list[Any]:
    """The condition of the scene's table [[hold]]."""
    facets = mesh.locate_entities_boundary(V.mesh, 2, lambda x: np.isclose(x[2], 0.0))
    return [fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets), V)]


def same(comm: Any, a: np.ndarray, b: np.ndarray, tolerance: float = 1e-8) -> bool:
    largest = comm.allreduce(float(np.abs(b).max()), max)
    return bool(
        largest > 1e-3 and comm.allreduce(float(np.abs(a - b).max()), max) < tolerance * largest
    )


PLATE = {"plane": {"point": [0, 0, 1.05], "normal": [0, 0, -1]}}
#: Loads by kind: tables of the scene, each with its keys.
LOADS: dict[str, list[tuple[str, dict[str, Any]]]] = {
    "traction": [
        ("traction", {"group": "top", "vector": [0.02, 0, 0.1]}),
        ("traction", {"group": "right", "vector": [0, 0.1, 0]}),
    ],
    "gravity": [("gravity", {"vector": [0, 0.02, -0.1]})],
    "pressure": [
        ("pressure", {"group": "top", "value": 0.1}),
        ("pressure", {"group": "right", "value": -0.05}),
    ],
    "spring": [
        ("spring", {"group": "right", "stiffness": [0.1, 0, 1]}),
        ("traction", {"group": "top", "vector": [0.1, 0, 0.1]}),
    ],
    "obstacle": [
        ("obstacle", {"shape": PLATE, "translate": [0, 0, -0.2], "group": "top", "friction": 0.2,
                      "name": "press"}),
    ],
    "table": [("pressure", {"group": "top", "value": 0.1, "table": "rise"})],
}  # fmt: skip


def run(kind: str, **keys: Any) -> Any:
    """Return the result of the scene with these loads."""
    tables = CUBE | keys | ({"table": [RISE]} if kind == "table" else {})
    for table, given in LOADS[kind]:
        tables = tables | {table: given if table == "gravity" else [*tables.get(table, []), given]}
    result = fem_snh.run(Scene.model_validate(tables), progress=False)
    assert result.converged
    return result


def terms(kind: str, domain: Any) -> list[Any]:
    """Return the same loads as objects; a group is a measure, and a table is a function."""
    ds, found = faces(domain), []
    for table, keys in LOADS[kind]:
        group = {"group": ds(GROUPS[keys["group"]])} if "group" in keys else {}
        given = keys | group | ({"table": rise} if "table" in keys else {})
        first = given.pop(next(iter(given)))
        found.append(FEATURES[table](first, **given))
    return found


@pytest.mark.one_debian
@pytest.mark.parametrize("kind", LOADS)
def test_statics(comm: Any, kind: str) -> None:
    """The same state as the scene's; the names of the terms are those of run.json."""
    result = run(kind)
    domain = result.problem.domain
    u = fem.Function(vector_space(domain))
    problem = fem_snh.NonlinearProblem(
        u, {SNH: ufl.dx}, bcs=bottom(u.function_space), terms=terms(kind, domain),
        densities={SNH: 2.0}, petsc_options=TIGHT,
    )  # fmt: skip
    problem.solve()
    assert problem.solver.getConvergedReason() > 0
    assert same(comm, u.x.array, result.problem.u.x.array)
    names = [term.name for term in problem._problem.terms]
    assert sorted(names) == sorted(result.record["terms"])


def given_as_ufl(terms: list[Any], domain: Any) -> tuple[list[Any], list[Any]]:
    """Return features with Constants for their values, and the Constants with the values."""
    found, constants = [], []
    for term in terms:
        key = next(k for k in ("vector", "value", "stiffness") if hasattr(term, k))
        value = np.array(getattr(term, key), float)
        constants.append((fem.Constant(domain, value), value))
        keys = {k: getattr(term, k) for k in type(term).model_fields}
        found.append(type(term)(**keys | {key: constants[-1][0]}))
    return found, constants


@pytest.mark.parametrize("kind", ["traction", "gravity", "pressure", "spring"])
def test_values_of_ufl(comm: Any, kind: str) -> None:
    """Constants that change between two solves give the state of the numbers."""
    domain, states = unit_cube(comm, 2), []
    numbers = terms(kind, domain)
    given, constants = given_as_ufl(numbers, domain)
    for some in (numbers, given):
        u = fem.Function(vector_space(domain))
        problem = fem_snh.NonlinearProblem(
            u, {SNH: ufl.dx}, bcs=bottom(u.function_space), terms=some,
            densities={SNH: 2.0}, petsc_options=TIGHT,
        )  # fmt: skip
        for factor in (0.3, 1.0) if some is given else (1.0,):
            before = u.x.array.copy()
            for constant, value in constants:
                constant.value = factor * value
            problem.solve()
        assert problem.reason.startswith("CONVERGED")
        states.append(u.x.array.copy())
    assert same(comm, states[1], states[0]) and not same(comm, before, states[0], 1e-2)


def test_a_pressure_that_varies(comm: Any) -> None:
    """Its resultant on a block that hardly strains is that of p(x) = 1 + x on the face."""
    domain = unit_cube(comm, 2)
    u = fem.Function(vector_space(domain))
    p = 1e-6 * (1 + ufl.SpatialCoordinate(domain)[0])
    problem = fem_snh.NonlinearProblem(
        u, {SNH: ufl.dx}, bcs=bottom(u.function_space),
        terms=[fem_snh.Pressure(faces(domain)(GROUPS["top"]), p)], petsc_options=TIGHT,
    )  # fmt: skip
    problem.solve()
    assert "varies over the surface" in problem.notes[0].text
    found = problem.reaction_force(problem._problem.definition.conditions[0])
    np.testing.assert_allclose(found, [0, 0, 1.5e-6], atol=1e-11)


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("kind", ["gravity", "pressure", "obstacle", "table"])
def test_time(comm: Any, kind: str) -> None:
    """Forces without a table are constant; a function is one of the time [s]."""
    result = run(kind, time={"duration": 2.0, "steps": 4, "mass": "lumped"})
    domain = result.problem.domain
    u = fem.Function(vector_space(domain))
    problem = fem_snh.DynamicProblem(
        u, {SNH: ufl.dx}, {SNH: 2.0}, duration=2.0, mass="lumped", bcs=bottom(u.function_space),
        terms=terms(kind, domain), petsc_options=TIGHT,
    )  # fmt: skip
    rows = list(problem.steps(4))
    assert all(row["converged"] for row in rows)
    assert same(comm, u.x.array, result.problem.u.x.array, 1e-6)
    assert rows[-1]["potential"] == pytest.approx(result.steps[-1]["potential"], rel=1e-5)
