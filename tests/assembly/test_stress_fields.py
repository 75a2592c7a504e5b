"""Stresses and strains at quadrature points and their means over cells, against exact states."""

from __future__ import annotations

import numpy as np
import pytest
from stress_states import (
    LAM,
    MU,
    NU,
    STIFFNESS,
    E,
    affine,
    close,
    displaced,
    evaluated,
    quadrature_points,
    slope,
    torsion,
    torsion_gradient,
    uniform,
)

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Region
from fem_snh.assembly.unknowns import create_unknowns
from fem_snh.kernels.material import material
from fem_snh.problem.problem import Problem
from fem_snh.runs.output.field_values import FieldValues
from fem_snh.runs.output.point_fields import POINT_FIELDS

mpi = pytest.mark.mpi
every = pytest.mark.parametrize("element", ELEMENTS)

# --- uniform states, in closed form --------------------------------------------------------------


@pytest.mark.one_debian
@every
def test_uniaxial_stretch(comm, element):
    """The free sides are free of stress: DESIGN's exact solution, with lambda + mu for lambda."""
    s = 1.6
    J = 1 + MU / (LAM + MU) * (1 - 1 / s)
    side = np.sqrt(J / s)
    pressure = uniform(J, ELEMENTS[element].volume)
    p = displaced(comm, element, affine(np.diag([side, s, side])), pressure)
    found = evaluated(p)
    P = MU * (s - J / s**2)
    sigma = P * s / J
    close(found["pk1_stress"], np.diag([0, P, 0]))
    close(found["cauchy_stress"], np.diag([0, sigma, 0]))
    close(found["von_mises"], sigma)
    close(found["hydrostatic_stress"], sigma / 3)
    close(found["principal_stresses"], [sigma, 0, 0])
    close(found["green_lagrange_strain"], np.diag([J / s - 1, s**2 - 1, J / s - 1]) / 2)
    close(found["principal_stretches"], [s, side, side])


# --- torsion: exact at the quadrature points -----------------------------------------------------


def gradients(p):
    """F at the quadrature points; of P1, by the edges of the deformed and the undeformed cell."""
    if p.element.name != "P1":
        return torsion_gradient(quadrature_points(p))
    corners = _dolfinx.geometry_x(p.domain)[_dolfinx.geometry_dofs(p.domain)]
    moved = corners + torsion(corners.reshape(-1, 3)).reshape(corners.shape)
    edges, deformed = (np.swapaxes(x[:, 1:] - x[:, :1], 1, 2) for x in (corners, moved))
    return (deformed @ np.linalg.inv(edges))[:, None]


@pytest.mark.one_debian
@pytest.mark.parametrize(
    "element", [pytest.param(e, marks=[mpi] if e in ("Q1P0", "P2P1") else []) for e in ELEMENTS]
)
def test_torsion_at_the_quadrature_points(comm, element):
    """P is `Material.pk1` of the exact F, with the element's pressure in place of U'(J)."""
    p = displaced(comm, element, torsion, slope)
    F, volume = gradients(p), ELEMENTS[element].volume
    J = np.linalg.det(F)
    chosen = material("stable_neo_hookean", E=E, nu=NU, barrier=False)
    P = chosen.pk1(F)
    points = FieldValues(p)
    if volume != "pointwise":
        weights = points._stresses.evaluate(p.x, ()).weights
        mean = (weights * J).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
        pressure = slope(quadrature_points(p)) if volume == "pressure" else 0
        if volume == "mean":
            pressure = STIFFNESS[volume] * (mean - 1)
        cofactor = J[..., None, None] * np.swapaxes(np.linalg.inv(F), -1, -2)
        P = P + (pressure - STIFFNESS[volume] * (J - 1))[..., None, None] * cofactor
    sigma = P @ np.swapaxes(F, -1, -2) / J[..., None, None]
    deviator = sigma - np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) / 3
    expected = {
        "pk1_stress": P,
        "cauchy_stress": sigma,
        "von_mises": np.sqrt(1.5 * (deviator**2).sum(axis=(-2, -1))),
        "hydrostatic_stress": np.trace(sigma, axis1=-2, axis2=-1) / 3,
        "principal_stresses": np.linalg.eigvalsh((sigma + np.swapaxes(sigma, -1, -2)) / 2)[
            ..., ::-1
        ],
        "green_lagrange_strain": (np.swapaxes(F, -1, -2) @ F - np.eye(3)) / 2,
        "principal_stretches": np.linalg.svd(F, compute_uv=False),
    }
    found, means = points.evaluate(POINT_FIELDS, "points"), points.evaluate(POINT_FIELDS)
    share = _dolfinx.quadrature(p.element.cell, p.element.quadrature)[1]
    share = share / share.sum()  # the cells of this cube are affine
    for name in POINT_FIELDS:
        close(found[name], expected[name])
        close(means[name], np.einsum("q,cq...->c...", share, expected[name]))


@pytest.mark.parametrize(
    "element, other", [("Q1", "filtered_neo_hookean"), ("P2P0", "neo_hookean")]
)
def test_each_region_has_the_stress_of_its_material(comm, element, other):
    """Every third cell is stiffer: of a material without an energy, or of another volume term."""
    whole = displaced(comm, element, torsion)
    cells = np.arange(len(_dolfinx.node_dofs(whole.V)), dtype=np.int32)
    materials = [whole.regions[0].material, material(other, E=5 * E, nu=0.3)]
    chosen = [cells[cells % 3 > 0], cells[cells % 3 == 0]]

    def solved(regions):
        V = _dolfinx.function_space(whole.domain, ELEMENTS[element].degree, (3,))
        unknowns = create_unknowns(_dolfinx.function(V, "u"), ELEMENTS[element])
        p = Problem(unknowns, ELEMENTS[element], regions, whole.dirichlet)
        whole.x.copy(p.x)
        return FieldValues(p).evaluate(["pk1_stress"], "points")["pk1_stress"]

    mixed = solved([Region(filling, part) for filling, part in zip(materials, chosen, strict=True)])
    for filling, part in zip(materials, chosen, strict=True):
        close(mixed[part], solved([Region(filling, cells)])[part])
