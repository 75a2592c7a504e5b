"""Large motions: orders of accuracy, energy over many steps, momenta of a spinning body."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Hold, cube
from motions import advance, displacement, equal_steps, moving, run, spin
from one_cell import CORNERS, OneCell

from fem_snh import _dolfinx
from fem_snh.assembly.regions import Filling
from fem_snh.choices import INTEGRATORS
from fem_snh.kernels.material import material

pytestmark = pytest.mark.one_debian

mpi = pytest.mark.mpi
TURNS = 10


def swing(integrator: str, steps: int):
    """Return displacement and velocity at 1 s of a block whose top is thrown sideways."""
    fillings = [Filling(material("neo_hookean", E=1.0, nu=0.3), None, 1.0)]
    p, d = moving(integrator, fillings=fillings, hold=[Hold("bottom")], duration=1.0)
    d.start(p, lambda X: 0.25 * X[:, 2:] * np.array([1.0, 0.3, 0.2]))
    run(p, d, steps)
    return displacement(p).copy(), d.v.x.array.reshape(-1, 3)[: len(p.coordinates)].copy()


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_observed_orders(integrator):
    """Order 1 of backward Euler, 2 of the others, of displacement and velocity."""
    order = 1 if integrator in ("backward_euler", "semi_implicit") else 2
    ends = [swing(integrator, steps) for steps in (40, 80, 160)]
    assert abs(ends[0][0]).max() > 0.2
    for coarse, middle, fine in zip(*ends, strict=True):
        ratio = abs(coarse - middle).max() / abs(middle - fine).max()
        assert np.log2(ratio) == pytest.approx(order, abs=0.1)


def test_energy_of_a_swinging_beam():
    """Newmark, 1,000 steps, three periods, deflections of half the length: drift below 0.5 %."""
    body = cube(MPI.COMM_WORLD, "hexahedron", 2)
    _dolfinx.geometry_x(body.domain)[:] *= np.array([4.0, 1.0, 1.0])
    p, d = moving("newmark", body=body, hold=[Hold("left")], duration=500.0)
    d.start(p, lambda X: 0.01 * X[:, :1] ** 2 * np.array([0, 0, 1.0]))
    first, energies, tips = d.energies(p), [], []
    for _ in advance(p, d, equal_steps(1000)):
        found = d.energies(p)
        energies.append(found["kinetic"] + found["elastic"])
        tips.append(displacement(p)[:, 2].max())
    assert max(tips) > 1.5
    start = first["kinetic"] + first["elastic"]
    assert abs(np.array(energies) / start - 1).max() <= 0.005
    assert found["numerical_dissipation"] == pytest.approx(start - energies[-1], abs=1e-12)


@pytest.mark.parametrize("integrator", ["newmark", "generalized_alpha"])
def test_momenta_of_a_spinning_body(integrator):
    """Ten turns: linear momentum to 1e-9, angular momentum of Newmark to 1e-3."""
    rate = 0.1
    p, d = moving(integrator, duration=TURNS * 2 * np.pi / rate)
    d.start(p, lambda X: spin(rate)(X) + np.array([0.1, 0.2, 0.3]))
    first, last = d.energies(p), {}
    worst = {"momentum": 0.0, "angular_momentum": 0.0}
    for _ in advance(p, d, equal_steps(100 * TURNS)):
        last = d.energies(p)
        for key in worst:
            change = np.linalg.norm(np.subtract(last[key], first[key]))
            worst[key] = max(worst[key], change / np.linalg.norm(first[key]))
    assert worst["momentum"] <= 1e-9
    assert worst["angular_momentum"] <= 1e-3
    assert first["momentum"] == pytest.approx(d.mass.total * np.array([0.1, 0.2, 0.3]), rel=1e-12)
    # M / 6 of a unit cube about its axis, and the momentum's moment about the origin.
    assert first["angular_momentum"][2] == pytest.approx(2 * (rate / 6 + 0.5 * 0.1), rel=1e-12)
    assert last["kinetic"] == pytest.approx(first["kinetic"], rel=1e-3)


@pytest.mark.parametrize(
    "integrator", [pytest.param(i, marks=[mpi] if i == "newmark" else []) for i in INTEGRATORS]
)
def test_a_turn_in_100_steps(integrator):
    """All keep linear momentum, and lose what the textbooks' formulas lose, in numpy."""
    rate = 0.1
    p, d = moving(integrator, duration=2 * np.pi / rate)
    d.start(p, spin(rate))
    first = d.energies(p)
    run(p, d, 100)
    last = d.energies(p)
    assert np.linalg.norm(last["momentum"]) <= 1e-9
    cell = OneCell(material("stable_neo_hookean", E=1.0, nu=0.45), 2.0)
    start = np.zeros((8, 3)), spin(rate)(CORNERS)
    *_, end = cell.steps(integrator, 2 * np.pi / rate / 100, 100, *start)
    energy, momentum = cell.energy_and_spin(*end)
    assert last["kinetic"] == pytest.approx(energy, rel=1e-7)
    assert last["angular_momentum"][2] == pytest.approx(momentum, rel=1e-7)
    energy = 1 - last["kinetic"] / first["kinetic"]
    angular_momentum = 1 - last["angular_momentum"][2] / first["angular_momentum"][2]
    losses = {  # docs/theory/dynamics.md
        "newmark": (0.0028, 0.0012),
        "generalized_alpha": (0.0019, 0.00074),
        "bdf2": (0.013, 0.0054),
        "backward_euler": (0.44, 0.25),
        "semi_implicit": (0.88, 0.65),
    }
    assert (energy, angular_momentum) == pytest.approx(losses[integrator], rel=0.04)
    assert last["numerical_dissipation"] == pytest.approx(energy * first["kinetic"], rel=0.2)
