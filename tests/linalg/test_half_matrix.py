"""The half of a matrix that the solver reads, against the AIJ matrix of the same problem."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from bodies import MINIMISING, Hold, cube, dense, problem, set_values, wave

import fem_snh
from fem_snh._petsc import default_options
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.linalg import half_matrix
from fem_snh.linalg.ssor_cg import SSOR, EisenstatCG, SSORSystem
from fem_snh.problem.problem import Problem

mpi = pytest.mark.mpi
#: The same sums, of which those from other ranks' cells may be rounded in another order.
BITS = 1e-15
TIGHT = {"snes_scaled_tol": 1e-12, "snes_linear_solver": "iterative"}


def pair(comm, element="Q1", E=1.0, size=0.05, hold=("x", "z")):
    """Return two equal problems with their Hessians, one stored as AIJ and one as a half."""
    found = []
    for half in (False, True):
        left = [Hold("left", components=hold)] if hold else []
        p = problem(cube(comm, ELEMENTS[element].cell, 3, 0.03), element, hold=left, E=E)
        if half:
            p.store_half()
        set_values(p, wave(size), p.x)
        p.prescribe(p.x)
        p.jacobian(p.x, "clamp")
        found.append(p)
    assert [p.P.getType() == "python" for p in found] == [False, True]
    return found


def vectors(p):
    x = p.x.duplicate()
    x.array[:] = np.random.default_rng(p.comm.rank).standard_normal(len(x.array))
    return x, p.x.duplicate(), p.x.duplicate()


def near(found, expected, tolerance=BITS):
    """Whether the norm of a difference of two vectors is small."""
    return (found - expected).norm() <= tolerance * expected.norm()


@mpi
@pytest.mark.parametrize("element", MINIMISING)
@pytest.mark.parametrize("E", [1.0, 1e-60, 1e60])
def test_a_half_is_the_matrix(comm, element, E):
    """Entries, products, norm and diagonal; E in units in which single precision overflows."""
    full, half = pair(comm, element, E)
    A, scale = dense(full.A), np.abs(dense(full.A)).max()
    np.testing.assert_allclose(dense(half.A), A, atol=BITS * scale)
    x, y, z = vectors(full)
    full.P.mult(x, y)
    half.P.mult(x, z)
    assert near(z, y)
    assert near(half.matrix.absolute_product(x), full.matrix.absolute_product(x))
    assert near(half.P.getDiagonal(), full.P.getDiagonal())
    kind = PETSc.NormType.NORM_INFINITY
    assert half.P.norm(kind) == pytest.approx(full.P.norm(kind), rel=BITS)
    assert half.matrix.constrained_diagonal == pytest.approx(full.matrix.constrained_diagonal)


@mpi
def test_the_aij_copy_follows_every_assembly(comm):
    """It is one object, whose values are those of the last assembly, and of a changed diagonal."""
    full, half = pair(comm)
    A = half.A
    for size, filter in ((0.2, "exact"), (0.0, "abs")):
        for p in (full, half):
            set_values(p, wave(size), p.x)
            p.jacobian(p.x, filter)
        assert half.A == A
        np.testing.assert_allclose(dense(A), dense(full.A), atol=BITS)
    diagonal = half.P.getDiagonal()
    diagonal.scale(2.0)
    half.P.setDiagonal(diagonal)
    assert near(half.A.getDiagonal(), diagonal)
    half.P.setDiagonal(diagonal, addv=PETSc.InsertMode.ADD)
    assert near(half.A.getDiagonal(), 2 * diagonal)


@mpi
def test_the_scale_of_the_floats_changes_nothing(comm, monkeypatch):
    """That is a power of two: what the solver makes of the matrix has the same digits."""
    systems = []
    for least in (half_matrix._LEAST, 1.0):
        monkeypatch.setattr(half_matrix, "_LEAST", least)
        _, p = pair(comm, hold=("x", "y", "z"))
        systems.append(SSORSystem(p.P, p.coordinates, 5))
        assert systems[-1].update(p.P) == 0
    small, one = systems
    ratio = small.scale / one.scale
    assert ratio <= 2.0**-20 and 0.5 <= one.matrix.struct.largest <= 1.0
    assert small.matrix.struct.largest == ratio * one.matrix.struct.largest
    for name, power in (("diagonal", 1), ("upper", 1), ("diagonal_inverse", -1)):
        found, expected = (s.matrix.arrays[name][:-4] for s in systems)
        assert np.array_equal(found, expected * ratio**power)
    found, expected = (s.deflation.arrays["image"] for s in systems)
    assert np.array_equal(found, expected * ratio)


@mpi
def test_solver_and_coarse_space_are_those_of_a_copy(comm):
    """D, its inverse, U, A Z and which unknowns are coupled agree with those made of AIJ."""
    full, half = pair(comm, hold=("x", "y", "z"))
    copied, own = (SSORSystem(p.P, p.coordinates, 5) for p in (full, half))
    assert (copied.update(full.P), own.update(half.P)) == (0, 0)
    ratio = own.scale / copied.scale
    for name in ("diagonal", "upper", "off_diagonal", "diagonal_inverse"):
        if name in copied.matrix.arrays:
            # The last four values are beyond the last block: loads of four lanes read them.
            found, expected = own.matrix.arrays[name], copied.matrix.arrays[name][:-4]
            expected = expected * (1 / ratio if "inverse" in name else ratio)
            atol = 1e-6 * np.abs(expected).max()
            np.testing.assert_allclose(found[: len(expected)], expected, atol=atol)
    image, expected = (s.deflation.arrays["image"] for s in (own, copied))
    np.testing.assert_allclose(image, ratio * expected, atol=1e-6 * ratio * np.abs(expected).max())
    translations = ratio * copied.matrix.translations
    atol = 1e-13 * ratio  # of sums of zeros
    np.testing.assert_allclose(own.matrix.translations, translations, atol=atol)
    free = np.ones(len(half.x.array_r), bool)
    free[half.constrained_dofs] = False
    assert np.array_equal(own.matrix.coupled_unknowns(0, 0).ravel(), free)


@mpi
def test_a_frozen_preconditioner_stays(comm):
    """The trust region's norm is that of the clamped Hessian while the exact one is assembled."""
    found = []
    for p in pair(comm, hold=("x", "y", "z")):
        pc = PETSc.PC().create(comm)
        pc.setOperators(p.P)
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(SSOR())
        pc.setUp()
        x, y, z = vectors(p)
        pc.apply(x, y)
        set_values(p, wave(0.6), p.x)
        p.jacobian(p.x, "exact")
        pc.setReusePreconditioner(True)
        pc.apply(x, z)
        assert near(z, y, 1e-15)
        found.append(y)
        pc.destroy()
    assert near(found[1], found[0], 1e-5)


@mpi
@pytest.mark.parametrize("subdomains", [0, 5])
def test_refinement_reaches_double_precision(comm, subdomains):
    """A solution to 1e-12, where single precision leaves 1e-7."""
    _, p = pair(comm, hold=("x", "y", "z"))
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(p.P)
    ksp.setType(PETSc.KSP.Type.PYTHON)
    ksp.setPythonContext(EisenstatCG(p.coordinates))
    ksp.getPC().setType(PETSc.PC.Type.NONE)
    ksp.setTolerances(rtol=1e-13, atol=0.0, max_it=1000)
    with default_options("", {"ksp_deflation_subdomains": subdomains}):
        ksp.setFromOptions()
    x, b, r = vectors(p)
    p.P.mult(x, b)
    ksp.solve(b, x)
    p.A.mult(x, r)
    assert ksp.getConvergedReason() > 0
    assert near(r, b, 1e-12)


@mpi
@pytest.mark.parametrize("scene", ["stretch", "press"])
def test_runs_do_not_depend_on_the_format(comm, scene, monkeypatch):
    """The same energies with a half as with AIJ, also with contact."""
    rows, stored, store = [], [], Problem.store_half
    for asked in (store, lambda problem: None):
        monkeypatch.setattr(Problem, "store_half", lambda p, ask=asked: stored.append(p) or ask(p))
        result = fem_snh.run(scene, cells=4, steps=2, nu=0.4, petsc=TIGHT, progress=False)
        rows.append([step["energy"] for step in result.steps])
    assert [p.P.getType() == "python" for p in stored] == [True, False]
    assert rows[0] == pytest.approx(rows[1], rel=1e-9)


def test_what_needs_aij_has_it(comm):
    """A matrix that exists, and one with pressures, keep their format."""
    p, q = problem(cube(comm, "hexahedron"), "Q1"), problem(cube(comm, "tetrahedron"), "P2P1")
    A = p.A
    for body in (p, q):
        body.store_half()
        assert body.P == body.A
    assert p.A == A
