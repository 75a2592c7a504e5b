"""Several materials in one body: assembly against bodies of one material, and exact solutions."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import create_problem, dense, norm, set_values, wave

from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Filling
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.runs import run
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Scene

COMM = MPI.COMM_WORLD


def bar(element: str, materials: list[Any], cells: int = 2) -> Any:
    """A problem of a bar whose halves are filled by two materials, or the whole by one."""
    body = mesh.generate(COMM, "bar", ELEMENTS[element].cell, cells=cells)
    fillings = [Filling(m, group) for m, group in zip(materials, ("first", None), strict=False)]
    return create_problem(body, ELEMENTS[element], fillings if len(fillings) > 1 else materials[0])


def state(p: Any) -> Any:
    """Set the unknowns to smooth fields, and return them."""
    if not p.saddle_point:
        return set_values(p, wave(0.05))
    X = p.coordinates
    p.x.array[: X.size] = wave(0.05)(X).ravel()
    Q, n = p.saddle_point.Q, len(p.saddle_point.pressure_dofs(p.x))
    p.saddle_point.pressure_dofs(p.x)[:] = 0.1 * np.sin(
        Q.tabulate_dof_coordinates()[:n].sum(axis=1)
    )
    return p.x


def residual(p: Any) -> np.ndarray:
    r = p.x.duplicate()
    p.gradient(state(p), r)
    return r.array.copy()


@pytest.mark.one_debian("serial")
@pytest.mark.parametrize(
    ("element", "names"),
    [
        pytest.param("Q1", ("filtered_neo_hookean", "fixed_corotational"), marks=pytest.mark.mpi),
        ("P2P0", ("stable_neo_hookean", "neo_hookean")),
        ("P2P1", ("stable_neo_hookean", "neo_hookean_ogden")),
    ],
)
def test_halves_add_up(element: str, names: tuple[str, str]) -> None:
    """(a, b) and (b, a) together are a and b: forces of stretches, of a stress, of invariants."""
    a, b = material(names[0], E=1.0, nu=0.3), material(names[1], E=1.0, nu=0.45)
    halves = [bar(element, [a, b]), bar(element, [b, a])]
    wholes = [bar(element, [m]) for m in (a, b)]
    for p in halves:
        assert p.has_energy == (a.expression.has_energy and b.expression.has_energy)
        # The unit of the pressure unknown depends on the moduli, which are the same.
        assert p.modulus == 1.0
    sums = [sum(residual(p) for p in pair) for pair in (halves, wholes)]
    assert norm(COMM, sums[0] - sums[1]) <= 1e-12 * norm(COMM, sums[1])
    assert norm(COMM, residual(halves[0]) - residual(halves[1])) > 0.01 * norm(COMM, sums[1])
    for p in (*halves, *wholes):
        p.jacobian(state(p), "clamp")
    matrices = [sum(dense(p.A) for p in pair) for pair in (halves, wholes)]
    np.testing.assert_allclose(*matrices, atol=1e-12 * np.abs(matrices[1]).max())


def layers(element: str) -> Scene:
    """Two layers side by side, stretched along the interface by 1.3 and confined in z."""
    snh = {"name": "stable_neo_hookean", "barrier": False}
    held = (("left", "x"), ("front", "y"), ("bottom", "z"), ("top", "z"))
    return Scene(
        name="layers", mesh=Geometry(source="bar"), cells=1, element=element,
        material=[
            MaterialChoice(E=1.0, nu=0.3, group="first", **snh),
            MaterialChoice(E=3.0, nu=0.45, group="second", **snh),
        ],
        hold=[Hold(group=group, components=(axis,)) for group, axis in held],
        move=[Move(group="back", translate=(0, 0.3, 0), components=("y",))],
        petsc={"snes_scaled_tol": 1e-12},
    )  # fmt: skip


def thickness(region: Any, stretch: float = 1.3) -> float:
    """Return the stretch across a layer: P_xx = mu t + (lambda (J - 1) - mu) s = 0, J = s t."""
    mu, lam = region.material.expression.values
    return stretch * (mu + lam) / (mu + lam * stretch**2)


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("element", ["Q1", "P2P0"])
def test_bar_of_two_materials_is_exact(element: str) -> None:
    """The deformation is homogeneous in each layer, which every element represents."""
    result = run(layers(element), progress=False)
    p = result.problem
    first, second = map(thickness, p.regions)
    assert result.converged and abs(first - second) > 0.02
    X = p.coordinates
    x = np.minimum(X[:, 0], 1) * first + np.maximum(X[:, 0] - 1, 0) * second
    u = p.x.array_r[: X.size].reshape(-1, 3)
    np.testing.assert_allclose(u, np.stack([x - X[:, 0], 0.3 * X[:, 1], 0 * x], axis=1), atol=1e-9)
