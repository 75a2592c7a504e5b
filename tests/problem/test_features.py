"""Loads as objects of a dolfinx program: the numbers of the scene with the same tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import vector_space

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
#: Numbers of the faces x = 1 and z = 1.
RIGHT, TOP = 1, 3
RISE = {"name": "rise", "points": [[0, 0], [0.5, 0.1], [1, 0.5]]}


def rise(x: float) -> float:
    return float(np.interp(x, [0, 0.5, 1], [0, 0.1, 0.5]))


def faces(domain: Any) -> Any:
    """The measure ds with the numbers RIGHT and TOP."""
    found = [
        mesh.locate_entities_boundary(domain, 2, lambda x, axis=axis: np.isclose(x[axis], 1.0))
        for axis in (0, 2)
    ]
    facets = np.concatenate(found).astype(np.int32)
    values = np.repeat(np.array([RIGHT, TOP], np.int32), [len(part) for part in found])
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, 2, facets[order], values[order])
    return ufl.Measure("ds", domain=domain, subdomain_data=tags)


def bottom(V: Any) -> list[Any]:
    """The condition of the scene's table [[hold]]."""
    facets = mesh.locate_entities_boundary(V.mesh, 2, lambda x: np.isclose(x[2], 0.0))
    return [fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets), V)]


def same(comm: Any, a: np.ndarray, b: np.ndarray, tolerance: float = 1e-8) -> bool:
    largest = comm.allreduce(float(np.abs(b).max()), max)
    return bool(
        largest > 1e-3 and comm.allreduce(float(np.abs(a - b).max()), max) < tolerance * largest
    )


UP, ALONG = [0.02, 0, 0.1], [0, 0.1, 0]
LOADS: dict[str, tuple[dict[str, Any], Any]] = {
    "traction": (
        {"traction": [{"group": "top", "vector": UP}, {"group": "right", "vector": ALONG}]},
        lambda ds: [fem_snh.Traction(ds(TOP), UP), fem_snh.Traction(ds(RIGHT), ALONG)],
    ),
    "gravity": (
        {"gravity": {"vector": [0, 0.02, -0.1]}},
        lambda ds: [fem_snh.Gravity([0, 0.02, -0.1])],
    ),
    "pressure": (
        {"pressure": [{"group": "top", "value": 0.1}, {"group": "right", "value": -0.05}]},
        lambda ds: [fem_snh.Pressure(ds(TOP), 0.1), fem_snh.Pressure(ds(RIGHT), -0.05)],
    ),
    "spring": (
        {
            "spring": [{"group": "right", "stiffness": [0.1, 0, 1]}],
            "traction": [{"group": "top", "vector": [0.1, 0, 0.1]}],
        },
        lambda ds: [
            fem_snh.Spring(ds(RIGHT), [0.1, 0, 1]),
            fem_snh.Traction(ds(TOP), [0.1, 0, 0.1]),
        ],
    ),
    "obstacle": (
        {
            "obstacle": [
                {
                    "shape": {"plane": {"point": [0, 0, 1.05], "normal": [0, 0, -1]}},
                    "translate": [0, 0, -0.2],
                    "group": "top",
                    "friction": 0.2,
                    "name": "press",
                }
            ]
        },
        lambda ds: [
            fem_snh.Obstacle(
                {"plane": {"point": [0, 0, 1.05], "normal": [0, 0, -1]}},
                translate=[0, 0, -0.2],
                group=ds(TOP),
                friction=0.2,
                name="press",
            )
        ],
    ),
    "table": (
        {"pressure": [{"group": "top", "value": 0.1, "table": "rise"}], "table": [RISE]},
        lambda ds: [fem_snh.Pressure(ds(TOP), 0.1, rise)],
    ),
}


@pytest.mark.one_debian
@pytest.mark.parametrize("kind", LOADS)
def test_statics(comm: Any, kind: str) -> None:
    """The same state as the scene's; the names of the terms are those of run.json."""
    tables, terms = LOADS[kind]
    result = fem_snh.run(Scene.model_validate(CUBE | tables), progress=False)
    assert result.converged
    domain = result.problem.domain
    u = fem.Function(vector_space(domain))
    problem = fem_snh.NonlinearProblem(
        u,
        {SNH: ufl.dx},
        bcs=bottom(u.function_space),
        terms=terms(faces(domain)),
        densities={SNH: 2.0},
        petsc_options=TIGHT,
    )
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
    domain = mesh.create_unit_cube(comm, 2, 2, 2, mesh.CellType.hexahedron)
    terms, states = LOADS[kind][1](faces(domain)), []
    given, constants = given_as_ufl(terms, domain)
    for some in (terms, given):
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
    domain = mesh.create_unit_cube(comm, 2, 2, 2, mesh.CellType.hexahedron)
    u = fem.Function(vector_space(domain))
    p = 1e-6 * (1 + ufl.SpatialCoordinate(domain)[0])
    problem = fem_snh.NonlinearProblem(
        u, {SNH: ufl.dx}, bcs=bottom(u.function_space),
        terms=[fem_snh.Pressure(faces(domain)(TOP), p)], petsc_options=TIGHT,
    )  # fmt: skip
    problem.solve()
    assert "varies over the surface" in problem.notes[0].text
    found = problem.reaction_force(problem._problem.definition.conditions[0])
    np.testing.assert_allclose(found, [0, 0, 1.5e-6], atol=1e-11)


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("kind", ["gravity", "pressure", "obstacle", "table"])
def test_time(comm: Any, kind: str) -> None:
    """Forces without a table are constant; a function is one of the time [s]."""
    tables, terms = LOADS[kind]
    time = {"duration": 2.0, "steps": 4, "mass": "lumped"}
    result = fem_snh.run(Scene.model_validate(CUBE | tables | {"time": time}), progress=False)
    assert result.converged
    u = fem.Function(vector_space(result.problem.domain))
    problem = fem_snh.DynamicProblem(
        u,
        {SNH: ufl.dx},
        {SNH: 2.0},
        duration=2.0,
        mass="lumped",
        bcs=bottom(u.function_space),
        terms=terms(faces(u.function_space.mesh)),
        petsc_options=TIGHT,
    )
    rows = list(problem.steps(4))
    assert all(row["converged"] for row in rows)
    assert same(comm, u.x.array, result.problem.u.x.array, 1e-6)
    assert rows[-1]["potential"] == pytest.approx(result.steps[-1]["potential"], rel=1e-5)
