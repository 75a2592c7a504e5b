"""Stable and unstable equilibria: the inertia of the Hessian, and columns that buckle."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import tagged_measure, unit_cube, vector_space
from plane_programs import COMPONENTS, clamped
from running import solve
from scipy.optimize import brentq
from scipy.special import ellipk

import fem_snh
from fem_snh.linalg.direct_solver import SymmetricFactors
from fem_snh.solver.stability import EquilibriumStability, noise

mpi = pytest.mark.mpi
noted = pytest.mark.filterwarnings("ignore::fem_snh.errors.ResultNote")

#: Slenderness of the column, which is clamped at one end and has a dead load on the other.
LENGTH = 20.0
EULER = np.pi**2 / 12 / (4 * LENGTH**2)


def indefinite(comm, size=60, negative=4):
    """Return a symmetric matrix with so many negative eigenvalues, and it as an array."""
    rng = np.random.default_rng(3)
    q = np.linalg.qr(rng.normal(size=(size, size)))[0]
    values = np.concatenate([-np.arange(1.0, negative + 1), np.linspace(0.5, 90, size - negative)])
    array = q @ np.diag(values) @ q.T
    array = (array + array.T) / 2
    A = PETSc.Mat().createAIJ([size, size], comm=comm)
    A.setUp()
    for i in range(*A.getOwnershipRange()):
        A.setValues([i], range(size), array[i])
    A.assemble()
    return A, array


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("kinematics", COMPONENTS)
@pytest.mark.parametrize("inner", [1.0, 0.0])
def test_irregular_displacements_and_rotations_of_a_plane_mesh(comm, kinematics, inner):
    """Of a section beside the axis of revolution or at it: the Hessian at rest has no rotation.

    Irregular displacements move all components of all nodes but those that are zero on the axis.
    """
    problem = clamped(comm, kinematics, hold=False, inner=inner)
    off_axis = problem.coordinates[:, 0] > 1e-9
    moved = problem.nodal(noise(problem))
    assert moved.shape[1] == COMPONENTS[kinematics] and np.abs(moved[off_axis]).min() > 1e-5
    problem.jacobian(problem.x, "exact")
    rotations = EquilibriumStability(problem)._free_rotations(problem.x)
    assert (
        len(rotations)
        == {"plane_strain": 1, "axisymmetric": 0, "axisymmetric_torsion": 1}[kinematics]
    )
    for w in rotations:
        assert w.norm() > 1 and (problem.A * w).norm() < 1e-12 * w.norm()


@pytest.mark.one_debian("ranks")
@mpi
def test_negative_eigenvalues_and_the_lowest_eigenvector_are_those_of_numpy(comm):
    A, array = indefinite(comm)
    factors = SymmetricFactors(A)
    assert factors.factorise() == 4
    start = A.createVecRight()
    start.array = np.sin(1.0 + np.arange(*start.getOwnershipRange()))
    v = factors.negative_direction(4, start)
    lowest = np.linalg.eigh(array)[1][:, 0][slice(*v.getOwnershipRange())]
    assert abs(comm.allreduce(lowest @ v.array_r)) == pytest.approx(1, abs=1e-6)
    assert v.dot(start) > 0
    A.shift(2.5)
    assert factors.factorise() == 2
    A.shift(2.5)
    assert factors.factorise() == 0
    factors.close()


@mpi
@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_matrices_of_rank_one_remove_negative_eigenvalues(comm, scale):
    A, array = indefinite(comm)
    rows = A.getSizes()[0]
    U = PETSc.Mat().createDense((rows, (PETSc.DECIDE, 2)), comm=comm)
    U.setUp()
    columns = np.linalg.eigh(array)[1][:, [0, 10]] + 0.01
    U.getDenseArray()[:] = columns[slice(*A.getOwnershipRange())]
    U.assemble()
    c = PETSc.Vec().createSeq(2, comm=PETSc.COMM_SELF)
    c.array = np.array([scale, 1.0])
    factors = SymmetricFactors(A)
    whole = array + columns @ np.diag(c.array_r) @ columns.T
    left = factors.factorise() - factors.removed_by(PETSc.Mat().createLRC(A, U, c, U))
    assert left == np.count_nonzero(np.linalg.eigvalsh(whole) < 0)
    factors.close()


def column(comm, load, side=0.0, **settings):
    """Return a column of Q2 under a dead load in multiples of Euler's, with a part to the side."""
    body = mesh.create_box(
        comm, [np.zeros(3), np.array([LENGTH, 1.0, 1.0])], [10, 1, 1], mesh.CellType.hexahedron
    )
    V = vector_space(body, 2)
    u = fem.Function(V)
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0))
    ds = tagged_measure("ds", body, [lambda x: np.isclose(x[0], LENGTH)])
    force = fem.Constant(body, np.array([-1.0, 0.0, side]) * load * EULER)
    m = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    return fem_snh.NonlinearProblem(
        u, {m: ufl.dx}, bcs=[fem.dirichletbc(np.zeros(3), dofs, V)],
        terms=[-ufl.inner(force, u) * ds(1)], **settings,
    )  # fmt: skip


def elastica(load):
    """Return the head's displacement to the side over the length (Timoshenko & Gere 1961, 2.7)."""
    k = brentq(lambda k: ellipk(k**2) - np.pi / 2 * np.sqrt(load), 1e-9, 0.999)
    return 2 * k / ellipk(k**2)


def side_of(p):
    """Return the largest displacement to the side over the length."""
    u = p.x.array_r.reshape(-1, 3)[:, 1:]
    return p.x.comm.tompi4py().allreduce(np.linalg.norm(u, axis=1).max(initial=0), op=max) / LENGTH


def solved(p):
    p.solve()
    assert p.solver.getConvergedReason() > 0, p.reason
    return p


@noted
@mpi
def test_a_straight_column_is_stable_up_to_the_load_of_euler(comm):
    """The line search with a given Hessian is Newton's method, which keeps the symmetry."""
    for load, negative in ((0.98, 0), (1.02, 2)):
        p = solved(column(comm, load, hessian="exact"))
        assert side_of(p) < 1e-3
        assert p.negative_eigenvalues() == negative  # one for each plane
        assert [note.kind for note in p.notes] == ["unstable"] * (negative > 0)
    assert "2 negative eigenvalues" in p.notes[0].text


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("side", [0.0, 1e-4], ids=["perfect", "imperfect"])
def test_a_column_buckles_at_default_settings(comm, side):
    p = solved(column(comm, 1.3, side))
    assert p.solver.getPythonContext().linear_choice.direct
    assert side_of(p) == pytest.approx(elastica(1.3), rel=0.02)
    assert p.negative_eigenvalues() == 0 and not p.notes


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q1", "Q2Q1", "Q1P0"])
def test_a_scene_tells_stable_from_unstable(comm, element):
    """The pressures of a mixed element are not counted as instabilities."""
    given = {"element": element, "cells": 3, "aspect": 2.0, "stretch": 1.1, "steps": 2}
    result = fem_snh.run("stretch", comm=comm, progress=False, stability=True, **given)
    assert [row["stability"] for row in result.steps] == ["stable"] * 2
    assert [row["negative_eigenvalues"] for row in result.steps] == [0, 0]
    result = fem_snh.run("stretch", comm=comm, progress=False, **given)
    assert "stability" not in result.steps[0]


def clamped_column(comm, dim, across, element, approach):
    """Return a straight column of length 10, solved, whose ends approached, and a condition."""
    corners, counts = [np.zeros(dim), np.ones(dim)], [10 * across, *[across] * (dim - 1)]
    corners[1][0] = 10.0
    if dim == 2:
        body = mesh.create_rectangle(comm, corners, counts, mesh.CellType.quadrilateral)
    else:
        body = mesh.create_box(comm, corners, counts, mesh.CellType.hexahedron)
    V = vector_space(body, int(element[1]), dim)
    ends = [fem.locate_dofs_geometrical(V, lambda x, at=at: np.isclose(x[0], at)) for at in (0, 10)]
    values = np.zeros(dim), -10 * approach * np.eye(dim)[0]
    bcs = [fem.dirichletbc(value, dofs, V) for value, dofs in zip(values, ends, strict=True)]
    m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.3 if dim == 2 else 0.35)
    keys = {"element": element, "kinematics": "plane_strain" if dim == 2 else None}
    return bcs[1], solved(fem_snh.NonlinearProblem(fem.Function(V), {m: ufl.dx}, bcs=bcs, **keys))


@mpi
def test_a_straight_column_that_only_coarse_cells_keep_straight_has_no_estimate(comm):
    """It was printed: the column of the better element is straight, too, and unstable."""
    push, coarse = clamped_column(comm, 2, 1, "Q1", 0.045)
    assert coarse.negative_eigenvalues() == 0 and not coarse.notes
    estimate = coarse.estimate_error({"push": push})
    assert "unstable: its Hessian has 1 negative eigenvalue," in estimate.reason
    push, fine = clamped_column(comm, 2, 3, "Q2", 0.045)
    found = fine.estimate_error({"push": push})
    assert not found.reason and fine.negative_eigenvalues() == 0
    force = found.goals["push.x"]
    assert abs(force.error) < 0.01 * abs(force.value)
    assert abs(estimate.goals["push.x"].value) > 1.3 * abs(force.value)


@pytest.mark.parametrize(("asked", "found"), [(True, "4 negative"), (False, "negative")])
def test_the_lifted_state_is_examined_by_factors_or_iterations(asked, found, monkeypatch):
    """A cube that finer cells let fold: conjugate gradients and the pressure hid it."""
    monkeypatch.setattr("fem_snh.solver.stability._MAX_FACTORED", 10)
    keys = {"stretch": 0.5, "element": "Q2", "cells": 3, "nu": 0.35, "error": True}
    result = solve("pull", stability=asked, **keys)
    assert f"unstable: its Hessian has {found} eigenvalues" in result.estimate.reason


@noted
@mpi
@pytest.mark.parametrize("factored", [5_000, 10], ids=["factors", "iterations"])
@pytest.mark.parametrize(("part", "unstable"), [(0.8, False), (1.25, True)])
def test_the_end_of_a_mixed_column_is_examined(comm, part, unstable, factored, monkeypatch):
    """A straight one past buckling was converged without a note: Euler's strain is pi^2/300."""
    monkeypatch.setattr("fem_snh.solver.stability._MAX_FACTORED", factored)
    column = clamped_column(comm, 3, 1, "Q2Q1", part * np.pi**2 / 300)[1]
    assert column.solver.getType() == "python" and not column.solver.getPythonContext().trust_ksp
    assert [note.kind for note in column.notes] == ["unstable"] * unstable
    assert column.negative_eigenvalues() == 2 * unstable  # one for each plane


@mpi
def test_a_column_of_many_nodes_that_would_buckle_has_no_estimate(comm):
    """It is stable in the run's element, and the lifted one has 6,561 nodes."""
    push, column = clamped_column(comm, 3, 4, "Q1", 0.033)
    assert column.negative_eigenvalues() == 0
    reason = column.estimate_error({"push": push}).reason
    assert "unstable: its Hessian has negative eigenvalues" in reason


def forces_at_ends(body, size):
    """Return dead loads that pull the lower and the upper face of a cube apart."""
    ends = [lambda x: np.isclose(x[2], 0), lambda x: np.isclose(x[2], 1)]
    ds = tagged_measure("ds", body, ends)
    return [fem_snh.Traction(ds(tag), (0.0, 0.0, f)) for tag, f in ((1, -size), (2, size))]


@noted
@pytest.mark.one_debian("ranks")
@mpi
def test_a_rigid_motion_that_nothing_constrains_is_no_instability(comm):
    """The sign of its eigenvalue is rounding: a stretched body without supports has an estimate."""
    body = unit_cube(comm, 2, "tetrahedron")
    u, pull = fem.Function(vector_space(body, 2)), forces_at_ends(body, 800.0)
    m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.3)
    p = solved(fem_snh.NonlinearProblem(u, {m: ufl.dx}, terms=pull, element="P2"))
    assert p.negative_eigenvalues() == 0
    estimate = p.estimate_error(["volume"])
    assert not estimate.reason and abs(estimate.goals["volume"].error) < 1e-6


@noted
@mpi
@pytest.mark.parametrize(("stiffer", "pinned"), [(20.0, False), (1.0, False), (20.0, True)])
def test_a_free_body_under_pressure_is_no_instability(comm, stiffer, pinned):
    """H w = omega x r for a rotation w: residuals gave two or three negative eigenvalues.

    A corner that is held leaves all rotations, and of two materials the prestress is inhomogeneous.
    """
    body = unit_cube(comm, 2)
    V = vector_space(body)
    corner = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x, 0.0).all(axis=0))
    bcs = [fem.dirichletbc(np.zeros(3), corner, V)] if pinned else []
    dx = tagged_measure("dx", body, [lambda x: x[0] < 0.51, lambda x: x[0] > 0.49])
    materials = {
        fem_snh.material("stable_neo_hookean", E=E, nu=0.45): dx(tag)
        for tag, E in ((1, 1e4), (2, 1e4 * stiffer))
    }
    keys = {"terms": [fem_snh.Pressure(ufl.ds, 2000.0)], "element": "Q1P0"}
    p = solved(fem_snh.NonlinearProblem(fem.Function(V), materials, bcs=bcs, **keys))
    assert p.negative_eigenvalues() == 0
    estimate = p.estimate_error(["volume"])
    assert not estimate.reason and abs(estimate.goals["volume"].error) < 1e-3


@noted
@pytest.mark.one_debian("ranks")
@mpi
def test_a_free_body_under_dead_loads_that_push_is_unstable(comm):
    """It turns over: two rotations have a negative eigenvalue, which is no rounding."""
    body = unit_cube(comm, 1)
    u, push = fem.Function(vector_space(body)), forces_at_ends(body, -500.0)
    m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.3)
    keys = {"globalization": "linesearch", "hessian": "exact"}
    keys["petsc_options"] = {"ksp_type": "minres", "pc_type": "jacobi", "ksp_rtol": 1e-10}
    p = solved(fem_snh.NonlinearProblem(u, {m: ufl.dx}, terms=push, **keys))
    assert p.negative_eigenvalues() == 2
    # As many as the motions that nothing constrains, or less, were called rounding.
    assert "its Hessian has 2 negative eigenvalues" in p.estimate_error(["volume"]).reason
