"""Energies that are special cases of others, errata of the papers, mistakes in parameters."""

from __future__ import annotations

import numpy as np
import pytest
from points import make
from stretch_formulas import NU, STATES

pytestmark = pytest.mark.one_debian

# --- one family in another -----------------------------------------------------------------------

F = np.array([np.diag(s) for s in STATES])


@pytest.mark.parametrize(
    ("name", "shape", "same"),
    [
        ("seth_hill", {"n": 1}, "corotational"),
        ("seth_hill", {"n": 2}, "stvk"),
        ("hill", {"strain": "(s**2 - 1)/2"}, "stvk"),
        ("hill", {"strain": "s - 1"}, "corotational"),
        ("ogden", {"exponents": (2.0,), "weights": (1.0,)}, "neo_hookean_ogden"),
        ("ogden", {"exponents": (2.0,), "weights": (1.0,), "volume": "log"}, "neo_hookean"),
        ("arap", {"volume": "J"}, "fixed_corotational"),
        ("stable_arruda_boyce", {"betas": ()}, "gamma_model"),
        ("stable_fung", {"gamma": 0.0}, "gamma_model"),
        ("stvk_kikuuwe", {"kappa": 0.0}, "stvk"),
        ("sts", {"mu_4": 0.0}, "neo_hookean"),
        ("valanis_landel_xu", {"area": "0*a"}, "valanis_landel_new"),
        ("valanis_landel_new", {"length": "s**2/2", "volume": "(J-1)**2/2"}, "neo_hookean_ogden"),
        ("valanis_landel_new", {"volume": "log(J)**2/2"}, "valanis_landel"),
        ("gamma_model", {"length": "I_C"}, "gamma_model"),
        ("gamma_model", {"length": "I_C + exp((I_C - 3)/2)/10"}, "stable_fung"),
    ],
)
def test_special_cases(name, shape, same):
    one, other = make(name, NU, **shape), make(same, NU)
    assert one.energy(F) == pytest.approx(other.energy(F), rel=1e-10, abs=1e-13)
    assert one.pk1(F) == pytest.approx(other.pk1(F), rel=1e-9, abs=1e-11)
