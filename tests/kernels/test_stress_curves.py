"""Stress curves and the region of a positive tangent, against exact solutions."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from points import every_name, make

from fem_snh.kernels.reports import curves
from fem_snh.kernels.reports.curves import diagonal, stress
from fem_snh.kernels.reports.report import Report

pytestmark = pytest.mark.one_debian


@lru_cache
def reported(name: str, nu: float = 0.3) -> Report:
    return make(name, nu).report()


# --- curves --------------------------------------------------------------------------------------


def test_uniaxial_stable_neo_hookean_exactly():
    m = make("stable_neo_hookean", 0.49)
    mu, lam = m.constants
    c = curves.uniaxial(m)
    J = 1 + mu / lam * (1 - 1 / c.x)
    assert c.stress == pytest.approx(mu * (c.x - J / c.x**2), abs=1e-10)
    assert c.stretches[:, 1] == pytest.approx(np.sqrt(J / c.x), abs=1e-11)


@every_name
def test_curves_of_every_material(name):
    m = make(name)
    for c in reported(name).curves:
        known = np.isfinite(c.stress)
        # Without rest stability there may be no branch that leaves from rest.
        assert known.any() or reported(name).rest.verdict == "failed"
        assert c.stress.shape == c.x.shape == c.linear.shape
        if c.name in ("uniaxial", "equibiaxial") and known.any():
            assert np.nanmax(np.abs(stress(m, c.stretches)[known, 2])) < 1e-8 * m.expression.E
    if reported(name).rest.verdict == "failed":
        return
    h = 1e-5  # stvk_kikuuwe is no more than twice differentiable at rest
    for test in (curves.uniaxial, curves.equibiaxial, curves.volumetric):
        c = test(m, np.array([1 - h, 1.0, 1 + h]))
        assert c.stress[1] == pytest.approx(0, abs=1e-10)
        assert c.stress[2] - c.stress[0] == pytest.approx(c.linear[2] - c.linear[0], rel=1e-5)
    c = curves.shear(m, np.array([0.0, h]))
    assert c.stress[1] == pytest.approx(m.lame[0] * h, rel=1e-5)


# --- the tangent ---------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_where_textbooks_say_the_tangent_is_lost(nu):
    """Hencky's stress E log(s)/s falls beyond e; StVK's E (s^3 - s)/2 below 1/sqrt(3)."""
    for name, limit, side in (("hencky", np.e, 1), ("stvk", 3**-0.5, -1)):
        m = make(name, nu)
        ends = limit * (1 + side * np.array([-1e-6, 1e-6]))
        c = curves.uniaxial(m, np.append(np.linspace(1, limit, 9)[:-1], ends))
        scaling = curves.smallest(m, c.stretches)[1]
        assert (scaling[:-1] > -curves.TOLERANCE * m.expression.E).all() and scaling[-1] < 0


def test_volumetric_limits_of_stable_neo_hookean():
    """The block has mu (1 + s) + lam (s - s^4), twice, and mu (1 - 2 s) + lam (5 s^4 - 2 s)."""
    m = make("stable_neo_hookean", 0.49)
    mu, lam = m.constants
    high = max(np.roots([-lam, 0, 0, mu + lam, mu]).real)
    low = max(np.roots([5 * lam, 0, 0, -2 * (mu + lam), mu]).real)
    s = np.array([low * (1 - 1e-6), low * (1 + 1e-6), high * (1 - 1e-6), high * (1 + 1e-6)])
    scaling = curves.smallest(m, np.repeat(s[:, None], 3, axis=1))[1]
    assert list(scaling > 0) == [False, True, True, False]


@every_name
def test_regions_against_the_hessian(name):
    m = make(name)
    axis = np.array([0.3, 0.8, 1.0, 1.7])
    for plane in curves.PLANES:
        r = curves.region(m, plane, axis)
        s0, s1 = np.meshgrid(axis, axis)
        F = diagonal(np.stack([s0, s1, curves.PLANES[plane](s0, s1)], axis=-1))
        expected = np.linalg.eigvalsh(m.hessian(F))[..., 0]
        size = np.abs(m.hessian(F)).max(axis=(-1, -2))
        assert np.all(np.abs(r.tangent - expected) < 1e-7 * size)
        assert np.all(r.scaling >= r.tangent - 1e-12 * size)
