"""Lattices: volumes, energies, parts that do not touch, and mistakes."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import create_problem, set_values, wave
from running import solve

from fem_snh import scenes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.geometry.shapes import Box, Capsule, Sphere, Union
from fem_snh.kernels.material import material
from fem_snh.mesh import lattice, mesh

COMM = MPI.COMM_WORLD
HEXAHEDRA = [name for name, element in ELEMENTS.items() if element.cell == "hexahedron"]
#: A displacement gradient, and the deformation gradient.
H = np.array([[0.1, 0.2, 0.0], [0.0, -0.1, 0.1], [0.05, 0.0, 0.2]])
F = np.eye(3) + H


@pytest.mark.one_debian
@pytest.mark.parametrize(
    "shape, volume",
    [
        (Sphere((0.1, 0.2, 0.3), 1.0), 4 * np.pi / 3),
        (Capsule((0, 0, 0), (0.5, 0.6, 0.7), 0.4), np.pi * 0.16 * (np.sqrt(1.1) + 1.6 / 3)),
    ],
)
def test_the_volume_of_a_smooth_body_converges_with_the_square_of_the_samples(shape, volume):
    for cell in (0.31, 0.155):
        for samples in (2, 4, 8):
            fractions = lattice.lattice(shape, cell, samples=samples).fractions
            # The distance at a cube's centre is its mean up to a^2/24 times its Laplacian, 2/r:
            # 1/4 (a/r)^2 of the volume for a sphere, and the error of the sums.
            error = 0.4 * (cell / samples / shape.radius) ** 2
            assert fractions.sum() * cell**3 == pytest.approx(volume, rel=error)
            assert 0 < fractions.min() and fractions.max() <= 1


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("name", [n for n in HEXAHEDRA if ELEMENTS[n].volume != "pressure"])
def test_the_lattice_of_a_box_is_its_mesh(name):
    """Fractions of an aligned box are 1: energies and volumes are those of its mesh."""
    cube = mesh.generate(COMM, "cube", "hexahedron", cells=3)
    body = lattice.create(COMM, lambda: Box((0.5, 0.5, 0.5), (1, 1, 1)), 1 / 3)
    assert np.all(body.fractions == 1) and body.num_cells == 27
    assert [(g.label, g.count) for g in body.groups[:3]] == [
        ("volume:body", 27), ("surface:boundary", 54), ("surface:xmin", 9)
    ]  # fmt: skip
    snh = material("stable_neo_hookean", 1.0, 0.3)
    found, expected = (create_problem(part, ELEMENTS[name], snh) for part in (body, cube))
    for p in (found, expected):
        set_values(p, wave(0.1))
    assert found.energy(found.x) == pytest.approx(expected.energy(expected.x), rel=1e-12)
    ratios = [p.measures(p.x)["volume_ratio"] for p in (found, expected)]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-12)


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("name", [n for n in HEXAHEDRA if ELEMENTS[n].volume != "pressure"])
def test_energy_counts_by_the_fraction(name):
    """In a uniform deformation the energy is the density times the body's volume, or the cells'."""
    m = material("stable_neo_hookean", 1.0, 0.3)
    density = float(m.energy(F))
    sums = []
    for weighting in ("fraction", "full"):
        body = lattice.create(COMM, lambda: Sphere((0, 0, 0), 0.5), 0.24, weighting)
        p = create_problem(body, ELEMENTS[name], m)
        set_values(p, lambda x: x @ H.T)
        owned = body.domain.topology.index_map(3).size_local
        parts = owned if body.fractions is None else float(body.fractions[:owned].sum())
        sums.append(COMM.allreduce(parts))
        assert p.energy(p.x) == pytest.approx(density * sums[-1] * 0.24**3, rel=1e-11)
        assert p.measures(p.x)["volume_ratio"] == pytest.approx(np.linalg.det(F), rel=1e-11)
    assert sums[0] < sums[1] == body.num_cells


GAP = 0.05
#: Two rods along x, of thickness 0.1, that a palm joins at x = 0.
FINGERS = [
    {"box": {"center": [0.5, side * 0.5 * (0.1 + GAP), 0.0], "size": [1.0, 0.1, 0.1]}}
    for side in (-1, 1)
] + [{"box": {"center": [-0.1, 0, 0], "size": [0.2, 0.2 + GAP, 0.1]}}]


@pytest.mark.one_debian("ranks")
@pytest.mark.mpi
def test_parts_in_one_cell_move_on_their_own():
    """Two fingers, half a cell apart, are two beams."""
    tip = {"center": [1.0, 0.15, 0], "size": [0.02, 0.02, 0.2]}
    palm = {"center": [-0.1, 0, 0], "size": [0.22, 0.4, 0.4]}
    scene = scenes.Scene(
        name="fingers", mesh={"lattice": {"union": FINGERS}, "cell": 2 * GAP}, element="Q1",
        material={"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        bone=[{"name": "palm", "shape": {"box": palm}},
              {"name": "tip", "shape": {"box": tip}, "translate": [0, 0, 0.02]}],
        probe=[{"name": "other", "point": [1.0, -0.15, 0]}],
    )  # fmt: skip
    record = solve(scene).record
    assert record["cells"] == 46
    assert abs(record["steps"][-1]["probes"]["other"][2]) < 1e-12


@pytest.mark.mpi
def test_slits_that_end_at_a_face():
    """Two slits at different heights: all four parts are connected by the face between them."""
    heights = [(0, 0, 0.53), (0, 0.75, 1), (1, 0, 0.14), (1, 0.36, 1)]
    body = Union(tuple(Box((x + 0.5, 0.5, (a + b) / 2), (1, 1, b - a)) for x, a, b in heights))
    assert lattice.create(COMM, lambda: body, 1.0, samples=8, skin=8).num_cells == 2


def deflection(angle: float, cell: float) -> float:
    """Return the deflection of a beam's tip under its weight, turned in its lattice."""
    turn = {"rotation": [0, 0, angle]}
    axis = np.array([np.cos(angle), np.sin(angle), 0])
    beam = {"box": {"center": (0.5 * axis).tolist(), "size": [1, 0.2, 0.2], **turn}}
    root = {"box": {"center": (-0.4 * axis).tolist(), "size": [1.0, 1, 1], **turn}}
    scene = scenes.Scene(
        name="beam", mesh={"lattice": beam, "cell": cell, "samples": 8}, element="Q2",
        material={"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3, "density": 1.0},
        gravity={"vector": (0, 0, -1e-4)}, bone=[{"name": "root", "shape": root}],
        probe=[{"name": "tip", "point": (0.95 * axis).tolist()}],
    )  # fmt: skip
    return solve(scene, MPI.COMM_SELF).record["steps"][-1]["probes"]["tip"][2]


@pytest.mark.one_debian
def test_a_beam_turned_in_its_lattice_is_as_stiff_as_on_its_own_mesh():
    conforming = deflection(0.0, 0.1)
    # Euler and Bernoulli with a span of 0.9, w = rho g A, and the shear of a short beam.
    assert conforming == pytest.approx(-1e-4 * 0.04 * 0.9**4 / (8 * 0.2**4 / 12), rel=0.1)
    # The bone's end is between nodes: the span is longer by up to half a cell, which counts
    # with the fourth power.
    errors = [deflection(0.4, cell) / conforming - 1 for cell in (0.1, 0.07)]
    assert abs(errors[1]) < 0.05 < abs(errors[0]) < 0.25
