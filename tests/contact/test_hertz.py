"""A ball on a rigid plane and a half-space under a rigid ball, against Hertz (Johnson 1985)."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import Hold
from contact_problems import contact_problem, plane, press, translation

from benchmarks.pressed_ball import force_ratio
from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.geometry.motions import MovingShape
from fem_snh.geometry.shapes import Sphere
from fem_snh.mesh import mesh

pytestmark = pytest.mark.one_debian

E, NU, R = 2e4, 0.3, 50.0
#: E / (1 - nu^2): the plane is rigid.
MODULUS = E / (1 - NU**2)


def indented(comm, depth, cells, tolerance=None, half_space=False):
    """An octant of the body, indented by ``depth``: force, radius, peak pressure.

    They are relative to those of Hertz. The half-space is a half ball of 40 R, fixed there.
    """
    radius, size = np.sqrt(R * depth), 40 if half_space else 1
    geometry = {"zone": 1.25 * radius, "order": 2, "radius": size * R, "flat": int(half_space)}
    body = mesh.generate(comm, "indenter", "tetrahedron", cells=cells, **geometry)
    hold = [Hold("x = 0", ("x",)), Hold("y = 0", ("y",))]
    if half_space:
        obstacle = MovingShape(Sphere((0, 0, R), R), translation((0, 0, -depth)))
        hold.append(Hold("surface"))
    else:
        obstacle = plane((0, 0, -R), motion=translation((0, 0, depth)))
        hold.append(Hold("z = 0", ("z",)))
    support = RigidContact("other", obstacle, tolerance=tolerance, augmented=tolerance is not None)
    p, contact, _ = contact_problem(body, "P2", [support], E=E, nu=NU, hold=hold)
    row = press(p, tolerance=1e-9 / size**2)["obstacles"]["other"]
    u = p.split(p.x)[0]
    at = contact.pairs[0].points(u.array_r.reshape(-1, 3))
    area = 4 * contact.surface.weights[at.which][at.pressure > 0].sum()
    peak = contact.nodal_field("contact_pressure", u).max()
    assert row["penetration"] < (tolerance or 0.02 * depth)
    hertz = 4 / 3 * MODULUS * np.sqrt(R) * depth**1.5
    return (
        4 * abs(row["force"][2]) / hertz,
        np.sqrt(area / np.pi) / radius,
        peak / (2 * MODULUS * radius / (np.pi * R)),
    )


@pytest.mark.parametrize("depth", [0.2, 0.5])
@pytest.mark.parametrize("augmented", [False, True], ids=["penalty", "augmented"])
def test_a_half_space(comm, depth, augmented):
    """The body of Hertz's theory: both methods have its force and radius."""
    tolerance = 1e-3 * depth if augmented else None
    force, radius, _ = indented(comm, depth, 6, tolerance, half_space=True)
    assert force == pytest.approx(1, abs=0.01)
    assert radius == pytest.approx(1, abs=0.07)


@pytest.mark.parametrize("depth", [0.2, 0.5])
def test_force_without_penetration(comm, depth):
    """Hertz's balls are half-spaces; a ball on its equator is stiffer, by about a/(3 R)."""
    ball = force_ratio(depth / R, NU)
    assert ball - 1 == pytest.approx(0.34 * np.sqrt(depth / R), rel=0.1)
    force, _, _ = indented(comm, depth, 6, tolerance=1e-3 * depth)
    assert force == pytest.approx(ball, rel=5e-3)


def test_pressure_and_radius_of_ssnv104(comm):
    """code_aster's SSNV104: penetration 2, peak pressure 2,798.3 MPa, contact radius 10 mm."""
    assert 2 * MODULUS * 10 / (np.pi * R) == pytest.approx(2798.3, rel=1e-4)
    _, radius, peak = indented(comm, 2.0, 8)
    assert radius == pytest.approx(1, abs=0.1)
    assert peak == pytest.approx(1, abs=0.1)
