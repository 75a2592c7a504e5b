"""The rule that determines the constants of a material from E and nu."""

from __future__ import annotations

import numpy as np
import pytest

import fem_snh
from fem_snh.errors import BadInput

pytestmark = pytest.mark.one_debian


# --- the rule for constants ----------------------------------------------------------------------


def test_three_constants_move_least():
    """Of all constants with the wanted stiffness those nearest to the defaults, by projection."""
    E, nu = 2.0, 0.3
    found = np.array(fem_snh.material("mooney_rivlin", E=E, nu=nu).expression.values)
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    M = np.array([[2, 2, 0], [-4 / 3, -4 / 3, 1]])
    start = E * np.array([0.125, 0.0417, 1.0])
    assert M @ found == pytest.approx([mu, lam], rel=1e-12)
    expected = start + np.linalg.lstsq(M, np.array([mu, lam]) - M @ start, rcond=None)[0]
    assert found == pytest.approx(expected, rel=1e-10)


def test_prescribed_constants_that_contradict_the_modulus():
    """At E = 1e4 and nu = 0.49, mu_lame = 1e4 / 2.98 = 3355.704698 and 2 (C1 + C2) must be that."""
    message = (
        r"'mooney_rivlin' with C1 = 1000, C2 = 800.1 has the shear modulus 3600.2 Pa, "
        r"E and nu have 3355.704698 Pa: expected 2\*C1 \+ 2\*C2 = 3355.704698, "
        "or C1 or C2 without a value"
    )
    with pytest.raises(BadInput, match=message):
        fem_snh.material("mooney_rivlin", E=1e4, nu=0.49, C1=1e3, C2=800.1)
    with pytest.raises(BadInput, match="takes one alpha, and no lambda_part"):
        fem_snh.material(
            "mooney_rivlin", E=2.98, nu=0.49, C1=0.3, C2=0.2, lambda_part="neo_hookean"
        )
    with pytest.raises(BadInput, match=r"C1 = 1000, C2 = 677.852, kappa = 3 has no free constant"):
        fem_snh.material("mooney_rivlin", E=1e4, nu=0.49, C1=1e3, C2=677.852349, kappa=3.0)
