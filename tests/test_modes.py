"""Eigenfrequencies: beams, a dense solver, rigid modes, scaling, unstable states, ranks, files."""

from __future__ import annotations

import csv
import json
import subprocess
import sys

from mpi4py import MPI

import numpy as np
import pytest
from bodies import MINIMISING, Condition, Hold, cube, dense, held, problem, put, wave
from scipy.linalg import eigh
from scipy.optimize import brentq

import fem_snh
from fem_snh import _dolfinx, scenes
from fem_snh.errors import BadInput
from fem_snh.fem import eigenproblem, modes
from fem_snh.fem.elements import ELEMENTS
from fem_snh.fem.mesh import generate
from fem_snh.fem.problem import Problem
from fem_snh.fem.terms import mass_matrix
from fem_snh.scenes import Geometry

mpi = pytest.mark.mpi


def solve(scene="modes", comm=MPI.COMM_WORLD, **kwargs):
    return fem_snh.run(scene, comm=comm, progress=False, **kwargs)


def hertz(values):
    """Frequencies of eigenvalues omega^2, negative where these are."""
    return np.sign(values) * np.sqrt(abs(values)) / (2 * np.pi)


# --- oracles -------------------------------------------------------------------------------------


@mpi
@pytest.mark.parametrize("element", MINIMISING)
@pytest.mark.parametrize("strained", [False, True])
def test_against_a_dense_solver(comm, element, strained):
    """A tiny problem at rest and in a deformed state, which may be unstable."""
    body = cube(comm, ELEMENTS[element].cell, 1 if element[1] == "2" else 2, 0.03)
    p = problem(body, element, E=3.0, hold=[Hold("left"), Hold("front", ("y",))])
    if strained:
        put(p, wave(0.02))
        p.prescribe(p.x)
    found = modes.lowest(p, 2.0, 8)
    p.jacobian(p.x, "exact")
    K, M = dense(p.A), dense(mass_matrix(p.V, 2.0))
    free = np.concatenate(comm.allgather(~held(p)))
    K, M = K[free][:, free], M[free][:, free]
    expected = hertz(eigh((K + K.T) / 2, M, eigvals_only=True)[:8])
    assert found.frequencies == pytest.approx(expected, rel=1e-9)
    assert max(found.residuals) <= 1e-9
    pencil = eigenproblem.Eigenproblem(p, 2.0, "")
    ordered = eigh((K + K.T) / 2, M, eigvals_only=True)
    for k in (0, 3, len(ordered) - 1):
        bound = ordered[k] - 1e-3 * abs(ordered[k])
        assert pencil._count_below(bound) == (ordered < bound).sum()


@pytest.mark.parametrize("element", MINIMISING)
def test_mass_is_that_of_the_body_and_consistent(element):
    """Exact for products of the element's functions on a mesh of straight cells."""
    p = problem(cube(MPI.COMM_SELF, ELEMENTS[element].cell, 2, size=0.5), element)
    M = mass_matrix(p.V, 8.0)
    put(p, lambda X: np.array([1.0, 0, 0]) + 0 * X)
    y = p.x.duplicate()
    M.mult(p.x, y)
    assert p.x.dot(y) == pytest.approx(8.0 * 0.5**3, rel=1e-12)
    if element[1] == "2":
        put(p, lambda X: X**2)  # the integral of x^4 + y^4 + z^4
        M.mult(p.x, y)
        assert p.x.dot(y) == pytest.approx(8.0 * 3 * 0.5**7 / 5, rel=1e-12)


def timoshenko(ratio, nu, count):
    """omega L^2 sqrt(rho A/(E I)) of a cantilever of thickness 1 and length ``ratio``.

    E I w'' = ..., with rotary inertia r^2 = I/(A L^2) and shear s^2 = E I/(k G A L^2), k = 5/6:
    Huang 1961's frequency equation, below the cut-off.
    """
    r2 = 1 / 12 / ratio**2
    s2 = r2 * 2 * (1 + nu) * 6 / 5

    def equation(b):
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        al, be = np.sqrt((-(r2 + s2) + root) / 2), np.sqrt((r2 + s2 + root) / 2)
        c, ch = np.cos(b * be), np.cosh(b * al)
        s, sh = np.sin(b * be), np.sinh(b * al)
        return (
            2
            + (b**2 * (r2 - s2) ** 2 + 2) * ch * c
            - b * (r2 + s2) / np.sqrt(1 - b**2 * r2 * s2) * sh * s
        )

    grid = np.linspace(0.5, 80, 2000)
    signs = [equation(b) for b in grid]
    roots = [
        brentq(equation, a, b)
        for a, b, fa, fb in zip(grid, grid[1:], signs, signs[1:], strict=False)
        if fa * fb < 0
    ]
    return np.array(roots[:count])


def test_the_oracle_is_euler_and_bernoullis_in_the_limit():
    assert timoshenko(1e4, 0.3, 2) == pytest.approx([1.8751040687**2, 4.6940911330**2], rel=1e-6)


@mpi
@pytest.mark.parametrize("element", ["Q2", "P2"])
@pytest.mark.parametrize("nu, bound", [(0.0, 1e-3), (0.3, 6e-3)])
def test_a_slender_beam(comm, element, nu, bound):
    """A bar of 1 x 1 x 20 held at its end bends as Timoshenko's beam, to 0.1 %.

    With nu = 0.3 to 0.6 %: its section cannot shrink where it is held.
    """
    length, E, density = 20.0, 5.0, 3.0
    # The coarsest cylinder has a square section.
    body = generate(comm, "cylinder", ELEMENTS[element].cell, cells=3, radius=0.5**0.5, length=20)
    law = fem_snh.material("neo_hookean", E=E, nu=nu)
    found = modes.lowest(Problem(body, ELEMENTS[element], law, hold=[Hold("left")]), density, 4)
    unit = np.sqrt(E / 12 / density) / length**2 / (2 * np.pi)
    expected = np.repeat(timoshenko(length, nu, 2), 2) * unit
    assert found.frequencies == pytest.approx(expected, rel=bound)
    euler_bernoulli = 1.8751040687**2 * unit
    assert found.frequencies[:2] == pytest.approx([euler_bernoulli] * 2, rel=5e-3)
    for shape in found.shapes:
        assert shape.norm() > 0 and not shape.array_r[held(found.problem)].any()


# --- free bodies, multiple eigenvalues -----------------------------------------------------------


@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
@pytest.mark.parametrize("count", [3, 6, 14])
def test_a_free_cube_has_six_zero_modes_and_no_more(comm, element, count):
    p = problem(cube(comm, ELEMENTS[element].cell, 3), element, E=2.0)
    found = modes.lowest(p, 5.0, count)
    first = np.sqrt(2.0 / 5.0) / (2 * np.pi)  # of length 1
    assert len(found.frequencies) == count
    assert abs(np.array(found.frequencies[:6])).max() <= 1e-6 * first
    assert min(found.frequencies[6:], default=first) >= 0.5 * first
    gram = gram_of(found, 5.0)
    assert gram == pytest.approx(np.eye(count), abs=1e-9)


def gram_of(found, density):
    """The products of the shapes by mass, in units of mass length^2."""
    p = found.problem
    M, y = mass_matrix(p.V, density), p.x.duplicate()
    rows = []
    for shape in found.shapes:
        M.mult(shape, y)
        rows.append([other.dot(y) for other in found.shapes])
    assert found.mass == pytest.approx(density * p.length**3)
    return np.array(rows) / (found.mass * p.length**2)


@mpi
def test_a_copy_of_a_multiple_eigenvalue_that_is_missed_is_searched_for(comm, monkeypatch):
    p = problem(cube(comm, "hexahedron", 3), "Q1")
    expected = modes.lowest(p, 1.0, 9).frequencies
    honest, calls = eigenproblem.Eigenproblem._solve, []

    def forgetful(self, shift, count, known):
        pairs = honest(self, shift, count, known)
        calls.append(len(known))
        return pairs[1:] if not known else pairs  # one of the six zeros, or whichever came first

    monkeypatch.setattr(eigenproblem.Eigenproblem, "_solve", forgetful)
    assert modes.lowest(p, 1.0, 9).frequencies == pytest.approx(expected, rel=1e-9, abs=1e-7)
    assert len(calls) > 1 and calls[0] == 0


@mpi
def test_an_unstable_state_has_negative_frequencies(comm):
    """Pressed to 0.4 of its length between smooth plates, a slender bar wants to buckle."""

    def press(X, load):
        return -0.4 * load * X * [1, 0, 0]

    rollers = [Hold("left"), Condition("right", press)]
    body = cube(comm, "hexahedron", 4)
    _dolfinx.geometry_x(body.domain)[:, 0] *= 6
    p = problem(body, "Q1", hold=rollers[:1], move=rollers[1:])
    p.set_load(1.0)
    put(p, lambda X: press(X, 1.0))
    found = modes.lowest(p, 1.0, 6)
    p.jacobian(p.x, "exact")
    K, M = dense(p.A), dense(mass_matrix(p.V, 1.0))
    free = np.concatenate(comm.allgather(~held(p)))
    expected = hertz(eigh(K[free][:, free], M[free][:, free], eigvals_only=True)[:6])
    assert expected[0] < 0
    assert found.frequencies == pytest.approx(expected, rel=1e-7)


# --- scaling, materials, ranks -------------------------------------------------------------------


@mpi
def test_frequencies_scale_as_the_square_root_of_E_over_density_over_length(comm):
    found = []
    for E, density, size in ((1.0, 1.0, 1.0), (200e9, 7800.0, 1e-3), (1e3, 1e3, 50.0)):
        p = problem(cube(comm, "hexahedron", 2, size=size), "Q1", E=E, hold=[Hold("left")])
        unit = np.sqrt(E / density) / size
        found.append(np.array(modes.lowest(p, density, 5).frequencies) / unit)
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[2] == pytest.approx(found[0], rel=1e-9)


def rest_stiffness(name, E, nu):
    law = fem_snh.material(name, E=E, nu=nu)
    p = Problem(
        cube(MPI.COMM_SELF, "hexahedron", 2, 0.05), ELEMENTS["Q1"], law, hold=[Hold("left")]
    )
    p.jacobian(p.x, "exact")
    return dense(p.A)


def test_normalised_materials_have_one_stiffness_at_rest():
    """Chen & Barbič's Figure 1: SNH and corotational at nu = 0.2, right and as it is often done.

    Naively SNH gets the Lame constants in the places of its own mu and lambda, of which it makes
    lambda_lame = lambda - mu (their Table 1): another E, and a nu below 0.
    """
    mine, theirs = (rest_stiffness(m, 1.0, 0.2) for m in ("stable_neo_hookean", "corotational"))
    assert abs(mine - theirs).max() <= 1e-10 * abs(theirs).max()
    mu, lam = 1 / 2.4, 1 / 2.4 * 0.4 / 0.6
    lam -= mu
    E, nu = mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
    assert (E, nu) == (pytest.approx(0.625), pytest.approx(-0.25))
    naive = rest_stiffness("stable_neo_hookean", E, nu)
    assert abs(naive - theirs).max() > 0.1 * abs(theirs).max()


@mpi
@pytest.mark.parametrize("material", ["fixed_corotational", "neo_hookean", "corotational"])
def test_materials_of_the_same_E_and_nu_have_the_same_frequencies(comm, material):
    setup = {"cells": 3, "count": 4}
    expected = solve(**setup).frequencies
    assert solve(material=material, **setup).frequencies == pytest.approx(expected, rel=1e-8)


@mpi
@pytest.mark.parametrize("free", [False, True])
def test_any_number_of_ranks_gives_the_same_frequencies(comm, free):
    setup = {"cells": 3, "count": 10, "aspect": 1.5, "element": "P2"}
    setup |= {"hold": []} if free else {}
    alone, together = solve(comm=MPI.COMM_SELF, **setup), solve(comm=comm, **setup)
    one, other = alone.frequencies, together.frequencies
    assert other == pytest.approx(one, rel=1e-9, abs=1e-6 * one[-1])
    start = 6 if free else 0
    assert other[start:] == pytest.approx(one[start:], rel=1e-9)


@mpi
def test_modes_of_a_loaded_state_come_after_the_load_steps(comm):
    """A pulled bar is stiffer across: its lowest frequency rises, as a string's."""
    setup = {"cells": 3, "steps": 1, "mesh": Geometry(source="cube"), "modes": {"count": 2}}
    found = [solve("pull", stretch=s, **setup) for s in (1.0 + 1e-9, 1.5)]
    assert found[1].frequencies[0] != pytest.approx(found[0].frequencies[0], rel=1e-2)
    assert all(step["reactions"] for step in found[1].steps)


# --- files ---------------------------------------------------------------------------------------


@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_record_table_and_shapes(comm, folder, element):
    pyvista = pytest.importorskip("pyvista")
    count = 4
    result = solve(cells=3, count=count, aspect=2.0, element=element, density=500.0, out=folder)
    comm.barrier()
    told = json.loads((folder / "run.json").read_text())["modes"]
    assert told == result.record["modes"]
    assert told["density"] == 500 and told["frequencies"] == result.frequencies
    assert len(told["residuals"]) == count and max(told["residuals"]) < 1e-9
    seconds = result.record["seconds"]
    assert min(seconds.values()) >= 0 and seconds["modes"] > 0
    with (folder / "modes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["frequency"]) for row in rows] == result.frequencies
    assert [int(row["mode"]) for row in rows] == [1, 2, 3, 4]
    reader = pyvista.get_reader(str(folder / "modes.pvd"))
    assert reader.time_values == [1, 2, 3, 4]
    for number in (1, 4):
        reader.set_active_time_value(number)
        grid = reader.read().combine()
        assert grid.n_cells == result.record["cells"]
        mode = grid.point_data["mode"]
        assert not grid.point_data["displacement"].any()
        assert not mode[grid.points[:, 0] < 1e-9].any() and abs(mode).max() > 0
    comm.barrier()
    again = solve("twist", cells=1, angle=0.1, out=folder, overwrite=True)
    comm.barrier()
    assert again.frequencies == [] and not list(folder.glob("modes*"))
    comm.barrier()


# --- mistakes ------------------------------------------------------------------------------------


@mpi
def test_more_modes_than_degrees_of_freedom(comm, folder):
    all_of_it = {"mesh": Geometry(source="cube"), "cells": 1, "element": "Q1"}
    assert len(solve(**all_of_it, count=12).frequencies) == 12
    with pytest.raises(BadInput, match=r"count = 13: there are only 12 free"):
        solve(**all_of_it, count=13, out=folder)
    assert not (folder / "run.json").exists()


@mpi
def test_without_slepc(comm, monkeypatch):
    monkeypatch.setitem(sys.modules, "slepc4py", None)
    monkeypatch.delitem(sys.modules, "slepc4py.SLEPc", raising=False)
    with pytest.raises(BadInput, match=r"modes need slepc4py .*install python3-slepc4py-real"):
        solve(cells=3)


@mpi
def test_no_convergence_is_told(comm, folder):
    few = {"modes_eps_max_it": 1, "modes_eps_ncv": 7, "modes_eps_tol": 1e-15}
    with pytest.raises(BadInput, match=r"SLEPc found \d+ of 6 eigenvalues .*-snh_modes_eps_max_it"):
        solve(cells=3, petsc=few, out=folder)
    comm.barrier()
    kept = json.loads((folder / "run.json").read_text())
    assert kept["status"].startswith("failed: modes: SLEPc found") and not kept["converged"]
    assert kept["steps"][0]["converged"] and "modes" not in kept
    comm.barrier()


def test_a_scene_without_modes_does_not_load_slepc():
    code = (
        "import fem_snh, sys; fem_snh.run('pull', cells=1, steps=1, progress=False); "
        "assert not [m for m in sys.modules if m.startswith('slepc4py')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    "overrides, told",
    [
        ({"modes.count": 0}, "modes.count = 0: expected a whole number from 1 to 2147483647"),
        ({"modes.density": 0}, r"modes.density = 0: expected a number > 0"),
        ({"modes.cuont": 3}, "modes: unknown key 'cuont': expected .*did you mean 'count'"),
        ({"modes": 3}, "modes = 3: expected a table"),
    ],
)
def test_mistakes_in_the_table(overrides, told):
    with pytest.raises(BadInput, match=told):
        scenes.load("twist", **overrides)


def test_a_table_of_modes_in_a_scene_file(tmp_path):
    text = 'mesh = "x.msh"\nelement = "Q1"\n[material]\nname = "stvk"\nE = 1\nnu = 0.3\n[modes]\n'
    (tmp_path / "x.toml").write_text(text.replace("stvk", "neo_hookean"))
    found = scenes.load(tmp_path / "x.toml").modes
    assert found is not None and (found.count, found.density) == (10, 1000.0)
