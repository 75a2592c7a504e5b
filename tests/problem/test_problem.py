"""Problems with known answers: patch tests, uniaxial stretch, traction, rigid motions."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import (
    FACES,
    MATERIALS,
    MINIMISING,
    Condition,
    Hold,
    create_problem,
    cube,
    every_energy,
    norm,
    problem,
    set_values,
    wave,
)

from fem_snh import Traction, solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material

mpi = pytest.mark.mpi
elements = pytest.mark.parametrize("element", MINIMISING)


def solve(p):
    """To a residual of 1e-12 E V^(2/3), by tight linear solves on any number of ranks."""
    snes = solver.create(p)
    snes.getPythonContext().options |= {"snes_scaled_tol": 1e-12, "snes_forcing_max": 0.0}
    snes.getKSP().setTolerances(rtol=1e-12, atol=1e-15 * p.force_scale)
    solver.Predictor(p, snes, "tangent").predict(1.0)
    snes.solve(None, p.x)
    assert solver.converged_reason(snes) == "CONVERGED_FNORM_ABS"


# --- affine states -------------------------------------------------------------------------------

G = np.array([[0.12, 0.05, -0.03], [0.02, -0.08, 0.06], [-0.04, 0.03, 0.1]])


@pytest.mark.one_debian("serial")
@elements
@every_energy
def test_patch(comm, element, name):
    """With an affine displacement on the boundary, all nodes of a bent mesh follow it."""

    def affine(X, load=1.0):
        return load * (X @ G.T + 0.1)

    body = cube(comm, ELEMENTS[element].cell, 3 if element in ("Q1", "P1") else 2, 0.05)
    p = problem(body, element, name, move=[Condition(face, affine) for face in FACES])
    solve(p)
    X = p.V.tabulate_dof_coordinates()[: p.x.getLocalSize() // 3]
    assert norm(comm, p.x.array - affine(X).ravel()) <= 1e-10 * p.x.norm()
    expected = p.regions[0].material.energy(np.eye(3) + G)
    assert p.energy(p.x) == pytest.approx(float(expected), rel=1e-10)
    found = p.measures(p.x)
    assert found["volume_ratio"] == pytest.approx(np.linalg.det(np.eye(3) + G), rel=1e-11)
    assert found["min_J"] == pytest.approx(found["volume_ratio"], rel=1e-9)


def bar(comm, element, name="stable_neo_hookean", bend=0.03, **kwargs):
    """A cube on three rollers, its sides free to slide."""
    rollers = [Hold("left", ("x",)), Hold("front", ("y",)), Hold("bottom", ("z",))]
    body = cube(comm, ELEMENTS[element].cell, 2, bend)
    return problem(body, element, name, hold=rollers, **kwargs)


@pytest.mark.one_debian
@mpi
@elements
@pytest.mark.parametrize("stretch", [1.5, 0.6])
def test_uniaxial_stretch_is_exact(comm, element, stretch):
    """eq. 13: J = 1 + (mu/lam)(1 - 1/s), lateral stretch sqrt(J/s), P11 = mu (s - J/s^2)."""

    def pull(X, load):
        return load * (stretch - 1) * X * [1, 0, 0]

    p = bar(comm, element, move=[Condition("right", pull, ("x",))])
    solve(p)
    mu, lam = p.regions[0].material.expression.values
    J = 1 + mu / lam * (1 - 1 / stretch)
    assert p.measures(p.x)["volume_ratio"] == pytest.approx(J, rel=1e-8)
    assert p.measures(p.x)["min_J"] == pytest.approx(J, rel=1e-8)
    lateral = np.sqrt(J / stretch)
    X = p.V.tabulate_dof_coordinates()[: p.x.getLocalSize() // 3]
    expected = X * [stretch - 1, lateral - 1, lateral - 1]
    assert norm(comm, p.x.array - expected.ravel()) <= 1e-8 * norm(comm, expected)
    # The reaction of the moved face, whose area is 1.
    reactions = p.x.duplicate()
    p.gradient(p.x, reactions)
    right = X[:, 0] > 1 - 1e-9
    force = comm.allreduce(float(reactions.array.reshape(-1, 3)[right, 0].sum()))
    assert force == pytest.approx(mu * (stretch - J / stretch**2), rel=1e-8)
    # Nothing pushes the body as a whole.
    total = sum(comm.allgather(reactions.array.reshape(-1, 3).sum(axis=0)))
    assert abs(total).max() <= 1e-10


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["Q1", "P2"])
@every_energy
def test_small_traction_is_linear_elasticity(comm, element, name):
    """u = t L / E along, -nu t L / E across, for every material: they agree at small strain."""
    E, t = 50.0, 50.0 * 1e-4
    p = bar(comm, element, name, E=E, features=[Traction("right", (t, 0, 0))])
    solve(p)
    assert [term.name for term in p.terms] == ["elastic", "traction"]
    nu = MATERIALS[name]["nu"]
    X = p.V.tabulate_dof_coordinates()[: p.x.getLocalSize() // 3]
    expected = t / E * X * [1, -nu, -nu]
    assert norm(comm, p.x.array - expected.ravel()) <= 1e-3 * norm(comm, expected)
    assert p.energy(p.x) == pytest.approx(-(t**2) / (2 * E), rel=1e-3)


@pytest.mark.one_debian("ranks")
@mpi
def test_traction_is_the_derivative_of_its_energy_and_follows_the_load(comm):
    t = np.array([0.3, -0.2, 0.5])
    p = bar(comm, "Q1", features=[Traction("right", t), Traction("top", -t)], bend=0.0)
    set_values(p, wave(0.05))
    other, force = p.x.duplicate(), p.x.duplicate()
    energies = []
    for load in (0.0, 0.5):
        p.set_load(load)
        p.gradient(p.x, other if load else force)
        energies.append(p.energy(p.x))
    force.axpy(-1, other)  # half the force
    assert energies[0] - energies[1] == pytest.approx(force.dot(p.x), rel=1e-10)
    total = sum(comm.allgather(force.array.reshape(-1, 3).sum(axis=0)))
    assert total == pytest.approx(0, abs=1e-12)  # +t and -t on faces of equal area
    X = p.V.tabulate_dof_coordinates()[: p.x.getLocalSize() // 3]
    top = X[:, 2] > 1 - 1e-9
    at_top = sum(comm.allgather(force.array.reshape(-1, 3)[top & (X[:, 0] < 0.75)].sum(axis=0)))
    assert at_top == pytest.approx(-0.5 * 0.75 * t, rel=1e-12)


@pytest.mark.one_debian("ranks")
@mpi
def test_without_an_energy_there_are_forces(comm):
    """Stresses that are no gradient balance all the same, and do so in an unmoved body."""
    filtered, body = material("filtered_neo_hookean", nu=0.3), cube(comm, "hexahedron", 2, 0.05)
    p = create_problem(body, ELEMENTS["Q1"], filtered, hold=[Hold("left")], reactions=["left"])
    assert not p.has_energy and problem(cube(comm, "hexahedron", 1), "Q1").has_energy
    with pytest.raises(BadInput, match="'filtered_neo_hookean' has no energy, only a stress"):
        p.energy(p.x)
    assert p.reactions(p.x)["left"] == pytest.approx([0, 0, 0], abs=1e-14)
    set_values(p, lambda X: 0.1 * X * [1, 0, 0])
    (force,) = p.reactions(p.x).values()
    assert force[0] == pytest.approx(-filtered.pk1(np.diag([1.1, 1, 1]))[0, 0], rel=1e-10)


# --- conditions ----------------------------------------------------------------------------------


@pytest.mark.one_debian
@mpi
@elements
def test_prescribed_values_are_exact_and_follow_the_load(comm, element):
    def turn(X, load):
        return load * np.stack([X[:, 1], -X[:, 0], 0 * X[:, 0]], axis=1)

    hold, move = [Hold("left"), Hold("corners", ("z",))], [Condition("right", turn, ("x", "y"))]
    p = problem(cube(comm, ELEMENTS[element].cell, 2), element, hold=hold, move=move)
    set_values(p, wave(1.0))
    before = p.x.array.copy()
    p.set_load(0.5)
    p.prescribe(p.x)
    n = p.x.getLocalSize() // 3
    X, u, w = p.V.tabulate_dof_coordinates()[:n], p.x.array.reshape(-1, 3), before.reshape(-1, 3)
    left, right = X[:, 0] < 1e-9, X[:, 0] > 1 - 1e-9
    corner = (abs(X - 0.5) > 0.5 - 1e-9).all(axis=1)
    assert not u[left].any() and not u[corner, 2].any()
    assert (u[right, :2] == turn(X[right], 0.5)[:, :2]).all()
    assert (u[right & ~corner, 2] == w[right & ~corner, 2]).all()
    assert (u[~left & ~right] == w[~left & ~right]).all()
    # What a ghost has is what its owner has, up to the rounding of their coordinates.
    with p.x.localForm() as local:
        mine = local.array.copy()
        p.x.ghostUpdate()
        assert local.array[p.constrained_dofs] == pytest.approx(mine[p.constrained_dofs], abs=1e-14)
