"""The inflated thick-walled tube against the exact solution of an incompressible one."""

from __future__ import annotations

from math import log2, sqrt

import pytest
from scipy.integrate import quad

import fem_snh
from fem_snh.scenes.builtin.tube import inflation_pressure


def errors(cells, kinematics, **parameters):
    """The errors of the radial displacements at the inner and the outer radius."""
    petsc = {"snes_scaled_tol": 1e-12}
    result = fem_snh.run(
        "tube", cells=cells, kinematics=kinematics, progress=False, petsc=petsc, **parameters
    )
    assert result.converged, result.status
    probes = result.steps[-1]["probes"]
    outer = sqrt(2**2 + 1.5**2 - 1) - 2
    return [abs(probes["inner"][0] - 0.5), abs(probes["outer"][0] - outer)]


def test_pressure_is_the_integral_of_the_hoop_stress():
    """p = int (sigma_t - sigma_r) dr / r, with the stretches r/R and R/r."""
    c = 1.5**2 - 1
    integral = quad(lambda r: (r**2 / (r**2 - c) - (r**2 - c) / r**2) / r, 1.5, sqrt(4 + c))[0]
    assert inflation_pressure(1.5, 1.0, 2.0) == pytest.approx(integral, rel=1e-12)


@pytest.mark.one_debian
def test_axisymmetric_tube_is_exact_to_fourth_order():
    """1e-6 on eight cells of Q2Q1."""
    coarse, fine = (max(errors(cells, "axisymmetric")) for cells in (4, 8))
    assert fine < 1e-6
    assert log2(coarse / fine) > 3.7


@pytest.mark.one_debian
def test_plane_strain_tube_converges_with_curved_cells():
    """Third order; cells with straight sides lose it."""
    coarse, fine = (max(errors(cells, "plane_strain")) for cells in (4, 8))
    assert fine < 1e-5
    assert log2(coarse / fine) > 2.7
    assert max(errors(8, "plane_strain", order=1)) > 20 * fine
