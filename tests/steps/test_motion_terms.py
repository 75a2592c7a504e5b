"""The terms of inertia and damping: mass matrices, derivatives, constrained rows and columns."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Condition, Hold, constrained, dense, wave
from mass_form import mass_matrix
from motions import advance, equal_steps, moving, run
from scipy.spatial.transform import Rotation

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.regions import Filling, cell_constant, fill_regions
from fem_snh.assembly.unknowns import add_ghosts, local_values, update_ghosts, writable_values
from fem_snh.choices import MASSES
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh

pytestmark = pytest.mark.mpi
MATERIAL = material("stable_neo_hookean", E=1.0, nu=0.45)
DENSITIES = (5.0, 0.5)


def slide(X, load):
    return np.outer(np.ones(len(X)), [0.2 * load, -0.1 * load**2, 0.1 * load])


def two_densities(element):
    """Return space and regions of a bar of two densities, distorted."""
    bar = mesh.generate(MPI.COMM_WORLD, "bar", ELEMENTS[element].cell, cells=2)
    x = _dolfinx.geometry_x(bar.domain)
    x += 0.03 * np.sin(x @ np.array([[1.0, 5, 2], [4, 2, 3], [3, 1, 7]]))
    V = _dolfinx.function_space(bar.domain, ELEMENTS[element].degree, (3,))
    fillings = [Filling(MATERIAL, g, rho) for g, rho in zip(("first", "second"), DENSITIES)]
    return V, fill_regions(bar, fillings)


def applied(V, mass, values):
    """Return M v on all local nodes for a function of coordinates."""
    out = _dolfinx.create_vector(V)
    writable_values(out)[:] = mass.apply(values(V.tabulate_dof_coordinates()).ravel())
    add_ghosts(out)
    update_ghosts(out)
    return out


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "Q2"])
def test_consistent_mass_is_that_of_the_form(element):
    """Against dolfinx's assembly of the bilinear form."""
    V, regions = two_densities(element)
    M = mass_matrix(V, cell_constant(V.mesh, regions, DENSITIES))
    v, expected = (_dolfinx.create_vector(V) for _ in range(2))
    values = wave(1.0)
    writable_values(v)[:] = values(V.tabulate_dof_coordinates()).ravel()
    M.mult(v, expected)
    found = applied(V, NodalMass(V, regions), values)
    np.testing.assert_allclose(found.array_r, expected.array_r, rtol=0,
                               atol=1e-12 * expected.norm())  # fmt: skip


@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "Q2"])
def test_lumped_mass(element):
    """Diagonal and positive, of the same total; of degree 1 the sums of the consistent rows."""
    V, regions = two_densities(element)
    consistent, lumped = (NodalMass(V, regions, kind) for kind in MASSES)
    assert lumped.total == pytest.approx(consistent.total, rel=1e-13)
    assert (lumped.matrix - lumped.matrix.multiply(np.eye(lumped.matrix.shape[0]))).nnz == 0
    ones = applied(V, lumped, np.ones_like)
    assert local_values(ones).min(initial=1) > 0
    if ELEMENTS[element].degree == 1:
        sums = applied(V, consistent, np.ones_like)
        np.testing.assert_allclose(ones.array_r, sums.array_r, rtol=1e-12)


def in_motion(element, **options):
    """Return a problem in its second step, at a state off the solution, and its dynamics."""
    p, d = moving("generalized_alpha", element, hold=[Hold("bottom", ("x", "z"))],
                  move=[Condition("left", slide)], duration=0.5, cells=2,
                  damping=(0.3, 0.2), **options)  # fmt: skip
    d.start(p, lambda X: 0.1 * X)
    for load in advance(p, d, equal_steps(4)[:1]):
        d.begin_step(p, load + 0.25)
    p.set_load(0.5)
    p.prescribe(p.x)
    return p, d


def mass_of(p, d):
    """Return the mass matrix on all unknowns, and which of them are displacements. Collective."""
    M = p.matrix.without_constraints()
    with M.adding():
        d.mass.add_to(M, 1.0)
    is_u = np.arange(p.x.getLocalSize()) < d.mass.num_owned
    return dense(M.mat), np.concatenate(p.comm.allgather(is_u))


def turned(p, state, h):
    """Return the rotation in h of each cell of the problem, by scipy: twice Cayley's half turn."""
    nodes = _dolfinx.node_dofs(p.V)
    x = (p.V.tabulate_dof_coordinates() + state.u.reshape(-1, 3))[nodes]
    v, turns = state.v.reshape(-1, 3)[nodes], []
    for r, velocity in zip(x - x.mean(axis=1, keepdims=True), v, strict=True):
        rows = np.concatenate([np.cross(np.eye(3), a).T for a in r])  # w x r
        w = np.linalg.lstsq(rows, velocity.ravel(), rcond=None)[0]
        angle = 2 * np.arctan(h / 2 * np.linalg.norm(w))
        turns.append(Rotation.from_rotvec(angle * w / np.linalg.norm(w)).as_matrix())
    return np.reshape(turns, (-1, 3, 3))


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_the_hessian_gets_mass_and_damping_without_constrained_dofs(element, mass):
    """The difference with and without the terms is c M + c_v (alpha M + beta K), free dofs only.

    K is that of the cells at the step's start, turned with their spin to its end.
    """
    p, d = in_motion(element, mass=mass)
    K = p.matrix.without_constraints()
    start = p.x.copy()
    start.array[: d.mass.num_owned] = d._step.state.u[: d.mass.num_owned]
    u, pressure = p.split(start)
    with K.adding():
        turns = turned(p, d._step.state, d._step.size)
        p.elastic.add_hessian(u, pressure, "objective", K, turns)
    p.jacobian(p.x, "exact")
    with_terms, free = dense(p.A), ~np.concatenate(p.comm.allgather(constrained(p)))
    M, is_u = mass_of(p, d)
    rate, velocity = d._balance.inertia.acceleration.rate, d._step.formulas.velocity.rate
    d._balance.inertia.acceleration = d._balance.damping.velocity = None
    p.jacobian(p.x, "exact")
    found = with_terms - dense(p.A)
    expected = (rate + 0.3 * velocity) * M + 0.2 * velocity * dense(K.mat)
    expected *= np.outer(free & is_u, free & is_u)
    assert abs(expected).max() > 1e-3
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * abs(expected).max())


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_the_residual_is_the_derivative_of_the_energy(element):
    """Central differences along a direction, constrained rows included."""
    p, _ = in_motion(element)
    direction, r, x = p.x.duplicate(), p.x.duplicate(), p.x.duplicate()
    direction.set(0.0)
    values = wave(1.0)(p.coordinates).ravel()
    direction.array[:] = 0.1  # of an unknown pressure, whose viscous part is in the energy
    direction.array[: len(values)] = values
    p.gradient(p.x, r)
    slope, energies, h = float(r.dot(direction)), [], 1e-5
    for sign in (1, -1):
        x.waxpy(sign * h, direction, p.x)
        energies.append(p.energy(x))
    assert slope == pytest.approx((energies[0] - energies[1]) / (2 * h), rel=1e-7)


@pytest.mark.one_debian("serial")
@pytest.mark.parametrize("element", ELEMENTS)
def test_damping_of_an_unstressed_body_is_rayleighs(element):
    """C = alpha M + beta K: a mode has the damping ratio (alpha / omega + beta omega) / 2."""
    p, d = moving("newmark", element, cells=1 if ELEMENTS[element].degree == 2 else 2,
                  duration=1.0, damping=(0.3, 0.2))  # fmt: skip
    d.start(p)
    d.begin_step(p, 0.5)
    rate, velocity = d._step.formulas.acceleration.rate, d._step.formulas.velocity.rate
    p.jacobian(p.x, "exact")
    whole = dense(p.A)
    d._balance.inertia.acceleration = d._balance.damping.velocity = None
    p.jacobian(p.x, "exact")
    K, (M, is_u) = dense(p.A), mass_of(p, d)
    found = ((whole - K - rate * M) / velocity)[np.ix_(is_u, is_u)]
    expected = (0.3 * M + 0.2 * K)[np.ix_(is_u, is_u)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * abs(whole).max() / velocity)
    assert abs(0.2 * K).max() > 1e-3


TURNING = [(element, "stable_neo_hookean") for element in ELEMENTS]
TURNING += [("Q1", "fixed_corotational"), ("P2P1", "fixed_corotational"), ("P2", "stvk")]
TURNING += [("Q1", "neo_hookean"), ("Q1P0", "neo_hookean")]


@pytest.mark.one_debian
@pytest.mark.parametrize("element, name", TURNING)
def test_damping_forces_of_a_turning_body(element, name):
    """None for the velocity of a rotation; no torque, no force and a loss for any other.

    The body is turned by 70 degrees and strained by a fifth; the axis of its spin is a third one,
    and the step turns it by 40 degrees. The velocity is that at the step's end.
    """
    fillings = [Filling(material(name, E=1.0, nu=0.45), None, 2.0)]
    p, d = moving("newmark", element, fillings=fillings, duration=1.0, damping=(0.0, 1.0))
    turn = Rotation.from_rotvec([0.7, 0.9, -0.4]).as_matrix()
    F = turn @ np.array([[1.2, 0.1, 0.0], [0.0, 0.95, 0.05], [0.0, 0.0, 0.9]])
    X, owned = p.V.tabulate_dof_coordinates(), d.mass.num_owned
    x = X @ F.T
    p.x.array[:owned] = (x - X).ravel()[:owned]
    w, h = np.array([0.3, -0.5, 0.4]), 1.0
    d.start(p, lambda _: np.cross(w, x))
    d.begin_step(p, h)
    angle = 2 * np.arctan(h / 2 * np.linalg.norm(w))
    end = x @ Rotation.from_rotvec(angle * w / np.linalg.norm(w)).as_matrix().T
    balance = d._balance
    other = wave(1.0)(X)
    size = p.comm.allreduce(abs(balance.damping_forces(other.ravel())).max(initial=0), MPI.MAX)
    assert size > 1e-3
    for axis in np.eye(3):
        rigid = np.cross(axis, end) + np.array([1.0, 2.0, 3.0])
        force = balance.damping_forces(rigid.ravel())
        assert abs(force).max(initial=0) <= 1e-12 * size
    force = balance.damping_forces(other.ravel()).reshape(-1, 3)
    own = end[: len(force)]
    total = p.comm.allreduce(np.array([force.sum(axis=0), np.cross(own, force).sum(axis=0)]))
    assert abs(total).max() <= 1e-12 * size
    assert p.comm.allreduce(float(force.ravel() @ other.ravel()[:owned])) > 0.1 * size


def test_work_and_dissipation_balance():
    """Newmark, prescribed motion and a changing load: what is lost falls faster than the step."""
    lost = []
    for steps in (20, 40):
        p, d = moving(
            "newmark", cells=2, hold=[Hold("bottom")], move=[Condition("top", slide)], duration=5.0,
            damping=(0.3, 0.0), gravity=(0, 0.1, 0), amplitude=lambda load: load**2,
        )  # fmt: skip
        d.start(p)
        run(p, d, steps)
        found = d.energies(p)
        lost.append(abs(found["numerical_dissipation"]))
        assert found["dissipated"] > 1e-3 and abs(found["work"]) > 1e-3
    assert lost[1] < 1e-3 * found["kinetic"]
    assert lost[1] < 0.4 * lost[0]
