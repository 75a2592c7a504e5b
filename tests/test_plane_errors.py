"""The estimate of the error in two dimensions: the layer of three, exact solutions, programs."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from running import solve


@pytest.mark.parametrize(
    ("element", "nu"), [("Q1P0", 0.3), ("Q1P0", 0.4999), ("Q1", 0.49), ("Q2", 0.3)]
)
def test_quadrilaterals_have_the_errors_of_the_layer_of_hexahedra(element, nu, monkeypatch):
    """Both lifted problems have the same solution, here to the solvers' smallest residual."""
    for name, value in {"_SETTLED": 0.0, "_ROUNDING": 0.0, "_OF_LARGEST": 0.0}.items():
        monkeypatch.setattr(f"fem_snh.accuracy.estimate.{name}", value)
    keys = {
        "element": element,
        "nu": nu,
        "cells": 3,
        "petsc": dict.fromkeys(("snes_scaled_tol", "lifted_snes_scaled_tol"), 1e-12),
    }
    keys |= {"accuracy.goals": ["corner", "left.moment.z", "energy"]}
    layer, plane = (
        solve("cook", kinematics=kinematics, **keys) for kinematics in ("layer", "plane_strain")
    )
    assert list(plane.goals) == ["corner.x", "corner.y", "left.moment.z", "energy"]
    for name, goal in plane.goals.items():
        other = layer.goals[name]
        assert goal["value"] == pytest.approx(other["value"], rel=1e-9)
        assert goal["error"] == pytest.approx(other["error"], rel=1e-6), name
    if (element, nu) != ("Q1P0", 0.3):  # its first pressure is zero in one of them alone
        mine, others = (r.estimate.indicators["corner.y"] for r in (plane, layer))
        assert np.sort(mine) == pytest.approx(np.sort(others), abs=1e-2 * np.abs(others).max())


OUTER = sqrt(2**2 + 1.5**2 - 1) - 2


@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric"])
@pytest.mark.parametrize("element", ["P1", "Q1", "Q1P0", "P2P1", "Q2Q1"])
def test_effectivity_on_a_tube(element, kinematics):
    """Against the exact solution of an incompressible tube."""
    nu = 0.5 if element in ("P2P1", "Q2Q1") else 0.4999
    result = solve("tube", element=element, nu=nu, cells=4, kinematics=kinematics, error=True)
    assert result.record["estimate"]["reason"] is None
    for name, exact in (("inner.x", 0.5), ("outer.x", OUTER)):
        goal = result.goals[name]
        assert 0.7 < goal["error"] / (exact - goal["value"]) < 1.4, name
        assert abs(goal["corrected"] - exact) < abs(goal["value"] - exact) / 3, name
