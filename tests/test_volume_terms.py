"""Mean dilatation and Taylor-Hood by hand: energy, forces and filtered matrices, in numpy and UFL.

What these elements do to a material is written here anew: the volume terms below, their derivatives
and their conjugates are typed in, cells are summed in numpy, and UFL derives the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from bodies import Hold, cube, dense, norm, one_cell, wave

from fem_snh import _dolfinx
from fem_snh.fem.elements import ELEMENTS
from fem_snh.fem.problem import Problem
from fem_snh.kernels.pointwise import material

mpi = pytest.mark.mpi
MIXED = [name for name, e in ELEMENTS.items() if e.volume != "pointwise"]
MEAN = [name for name in MIXED if ELEMENTS[name].volume == "mean"]
TAYLOR_HOOD = [name for name in MIXED if ELEMENTS[name].volume == "pressure"]


@dataclass(frozen=True)
class Volume:
    """U(J), which takes the material's lambda from lambda_local to lambda: k = their difference.

    curve : (U, U', U'') at J.
    rest : psi', the energy without U, in UFL, from F, mu_lame and lambda_local, where there is one.
    closed : whether U'(J) = p has a solution in closed form.
    """

    keywords: dict
    curve: Callable
    rest: Callable | None = None
    closed: bool = True


def quadratic(J, k):
    return k / 2 * (J - 1) ** 2, k * (J - 1), k + 0 * J


def logarithmic(J, k):
    return k / 2 * np.log(J) ** 2, k * np.log(J) / J, k * (1 - np.log(J)) / J**2


def stable(F, mu, local):
    """eq. 13, mu = mu_lame, lambda = lambda_lame + mu_lame."""
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * (J - 1) + (local + mu) / 2 * (J - 1) ** 2


def barrier(F, mu, local):
    """eq. 14 with the alpha of the errata: mu = 4/3 mu_lame, lambda = lambda_lame + 5/6 mu_lame."""
    J, I_C, mu, lam = ufl.det(F), ufl.inner(F, F), 4 / 3 * mu, local + 5 / 6 * mu
    alpha = 1 + 3 / 4 * mu / lam
    volume = lam / 2 * ((J - alpha) ** 2 - (1 - alpha) ** 2)
    return mu / 2 * (I_C - 3) - mu / 2 * ufl.ln((I_C + 1) / 4) + volume


LAWS = {
    "stable_neo_hookean": Volume({"name": "stable_neo_hookean", "nu": 0.49}, quadratic, stable),
    "stable_neo_hookean+barrier": Volume(
        {"name": "stable_neo_hookean", "nu": 0.3}, quadratic, barrier
    ),
    "neo_hookean": Volume({"name": "neo_hookean", "nu": 0.45}, logarithmic, closed=False),
    "fixed_corotational": Volume({"name": "fixed_corotational", "nu": 0.45}, quadratic),
}
HELD = [Hold("bottom"), Hold("right", ("x", "z"))]


def pairs(elements):
    """``element`` with each law that it takes."""
    taken = [(e, law) for e in elements for law in LAWS if e in MEAN or LAWS[law].closed]
    return pytest.mark.parametrize("element, law", taken)


def moduli(p):
    """(mu_lame, lambda_local, k) [Pa]: 1/lambda_local = 1/lambda + 1/(b mu)."""
    mu, lam = p.material.lame
    b = 2 if p.saddle_point else 4
    local = 1 / (1 / lam + 1 / (b * mu))
    return mu, local, lam - local


def problem(body, element, law, **conditions):
    return Problem(body, ELEMENTS[element], material(E=1.0, **LAWS[law].keywords), **conditions)


def put(p, field, push=0.0):
    """The displacement field((n, 3)) at this rank's nodes; waves of ``push`` for pressures."""
    n = 3 * _dolfinx.num_nodes(p.V)[0]
    p.x.array[:n] = field(p.V.tabulate_dof_coordinates()[: n // 3]).ravel()
    if p.saddle_point:
        Q, _ = p.saddle_point.Q, p.saddle_point.pressure()
        X = Q.tabulate_dof_coordinates()[: _dolfinx.num_nodes(Q)[0]]
        p.x.array[n:] = push * (np.sin(X @ [3.0, 5, 2]) - 0.7)
    return p


def wild(p, inverted):
    """A state with inverted points or, for energies that have no value there, almost."""
    size = 0.8
    put(p, wave(size), 0.8)
    while not inverted and p.measures(p.x)["min_J"] < 0.02:
        size *= 0.8
        put(p, wave(size), 0.8)
    assert np.isfinite(p.energy(p.x)) and (p.measures(p.x)["min_J"] < 0) == inverted
    return p


# --- cell by cell --------------------------------------------------------------------------------

LEVI_CIVITA = np.zeros((3, 3, 3))
for i, j, k in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
    LEVI_CIVITA[i, j, k], LEVI_CIVITA[j, i, k] = 1, -1


def cofactor(F):
    """dJ/dF, also of a singular F."""
    return np.einsum("ikm,jln,kl,mn->ij", LEVI_CIVITA, LEVI_CIVITA, F, F) / 2


def curvature(F):
    """d2J/dF2, (9, 9) on vec(F) by columns."""
    return np.einsum("ikm,jln,mn->jilk", LEVI_CIVITA, LEVI_CIVITA, F).reshape(9, 9)


def vec(F):
    return F.T.ravel()


def cells(p):
    """Per cell: its nodes; weights; F; B with vec(dF) = B du; values of the pressure's basis."""
    kind = p.element
    points, weights = _dolfinx.quadrature(kind.cell, kind.quadrature)
    basis = _dolfinx.tabulate(p.V, points)
    geometry = _dolfinx.tabulate_geometry(p.mesh.domain, points)
    x, u = _dolfinx.geometry_x(p.mesh.domain), p.u.x.array.reshape(-1, 3)
    for nodes, corners in zip(
        _dolfinx.node_dofs(p.V), _dolfinx.geometry_dofs(p.mesh.domain), strict=True
    ):
        T = [x[corners].T @ g for g in geometry]
        G = [b @ np.linalg.inv(t) for b, t in zip(basis, T, strict=True)]
        F = [np.eye(3) + u[nodes].T @ g for g in G]
        # entry 3 j + i of vec(F) is F_ij = ... + u_ai G_aj
        B = [np.einsum("aj,ik->jiak", g, np.eye(3)).reshape(9, -1) for g in G]
        yield nodes, weights * abs(np.linalg.det(T)), F, B


def pressures(p, volume, w, F, cell):
    """At each point of a cell: of the cell's mean J, or the unknown pressure's value."""
    if p.element.volume == "mean":
        mean = w @ np.linalg.det(F) / w.sum()
        return np.full(len(w), volume.curve(mean, moduli(p)[2])[1])
    Q, values = p.saddle_point.Q, p.saddle_point.pressure()
    points, _ = _dolfinx.quadrature(p.element.cell, p.element.quadrature)
    return _dolfinx.tabulate_values(Q, points) @ values[_dolfinx.node_dofs(Q)[cell]]


FILTERS = {"exact": lambda e: e, "clamp": lambda e: np.maximum(e, 0), "abs": np.abs}


def block_by_hand(p, volume, keep):
    """The displacement's block: sum of w B^T H B and, of a mean, U'' g g^T / V a cell."""
    k = moduli(p)[2]
    A = np.zeros((len(p.u.x.array),) * 2)
    for cell, (nodes, w, F, B) in enumerate(cells(p)):
        dofs = np.ix_(*[(3 * nodes[:, None] + np.arange(3)).ravel()] * 2)
        gradient = 0.0
        for q, pressure in enumerate(pressures(p, volume, w, F, cell)):
            J, c = np.linalg.det(F[q]), vec(cofactor(F[q]))
            _, slope, bend = volume.curve(J, k)
            H = p.material.hessian(F[q]) - bend * np.outer(c, c)
            H += (pressure - slope) * curvature(F[q])
            e, X = np.linalg.eigh(H)
            A[dofs] += w[q] * B[q].T @ (X @ np.diag(keep(e)) @ X.T) @ B[q]
            gradient = gradient + w[q] * B[q].T @ c
        if p.element.volume == "mean":
            mean = w @ np.linalg.det(F) / w.sum()
            stiff = keep(np.array(volume.curve(mean, k)[2]))
            A[dofs] += stiff / w.sum() * np.outer(gradient, gradient)
    return A


@pairs(MIXED)
@pytest.mark.parametrize("choice", FILTERS)
def test_filters_are_numpys_eigh_at_every_point(element, law, choice):
    """One cell that is no unit cell, inverted at some points."""
    p = problem(one_cell(MPI.COMM_SELF, ELEMENTS[element].cell), element, law)
    wild(p, p.material.expression.inversion_safe)
    p.jacobian(p.x, choice)
    found = dense(p.A)
    n = 3 * _dolfinx.num_nodes(p.V)[0]
    expected = block_by_hand(p, LAWS[law], FILTERS[choice])
    assert abs(found[:n, :n] - expected).max() <= 1e-10 * abs(expected).max()
    assert abs(found - found.T).max() <= 1e-14 * abs(found).max()
    if choice == "exact":
        assert np.linalg.eigvalsh(expected)[0] < 0  # there was something to filter
    elif element in MEAN:
        e = np.linalg.eigvalsh(found)
        assert e[0] >= -1e-12 * e[-1]


@pairs(MEAN)
def test_mean_dilatation_energy(element, law):
    """psi - U(J) at each point, and U of the mean of J once a cell."""
    p = problem(cube(MPI.COMM_SELF, ELEMENTS[element].cell, 2, 0.05), element, law)
    put(p, wave(0.05))
    found, volume = p.energy(p.x), LAWS[law]
    k, expected = moduli(p)[2], 0.0
    for _, w, F, _ in cells(p):
        J = np.linalg.det(F)
        points = p.material.energy(F) - volume.curve(J, k)[0]
        expected += w @ points + w.sum() * volume.curve(w @ J / w.sum(), k)[0]
    assert found == pytest.approx(expected, rel=1e-12)


#: Central differences of order 8: (multiple of the step, weight).
STENCIL = [(1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280)]


def difference(function, x, d, h):
    """d/ds function(x + s d) at s = 0."""
    total, moved = 0.0, x.duplicate()
    for multiple, weight in STENCIL:
        for sign in (1, -1):
            moved.waxpy(sign * multiple * h, d, x)
            total = total + sign * weight / h * function(moved)
    return total


@mpi
@pairs(MIXED)
def test_residual_and_jacobian_are_derivatives(comm, element, law):
    """Of the energy and of the residual, along a random direction, pressures included."""
    p = problem(cube(comm, ELEMENTS[element].cell, 2, 0.05), element, law, hold=HELD)
    put(p, wave(0.03), 0.3)
    r, d, Ad = (p.x.duplicate() for _ in range(3))
    d.array[:] = np.random.default_rng(comm.rank).uniform(-1, 1, d.getLocalSize())
    d.array[p.constrained_dofs] = 0
    p.residual(p.x, r)
    slope = difference(p.energy, p.x, d, 2e-3)
    assert slope == pytest.approx(r.dot(d), abs=1e-9 * r.norm() * d.norm())

    def residual(x):
        p.residual(x, r)
        return r.array.copy()

    found = difference(residual, p.x, d, 2e-3)
    p.jacobian(p.x, "exact")
    p.A.mult(d, Ad)
    free = np.ones(len(found), bool)
    free[p.constrained_dofs] = False
    assert norm(comm, (found - Ad.array)[free]) <= 1e-9 * norm(comm, found)


# --- Taylor-Hood, derived by UFL -----------------------------------------------------------------


@mpi
@pytest.mark.parametrize("element", TAYLOR_HOOD)
@pytest.mark.parametrize(
    "law, nu",
    [("stable_neo_hookean", nu) for nu in (0.1, 0.49, 0.4999, 0.5)]
    + [("stable_neo_hookean+barrier", 0.3)],
)
def test_taylor_hood_is_what_ufl_derives(comm, element, law, nu):
    """psi' + p J - U*(p), U* = p J(p) - U(J(p)), J(p) = 1 + p/k; at nu = 0.5 U* = p."""
    kind, volume = ELEMENTS[element], LAWS[law]
    # Rules that are the same for FFCx whatever degree an element has by default.
    kind = replace(kind, quadrature={"tetrahedron": 2, "hexahedron": 5}[kind.cell])
    body = cube(comm, kind.cell, 2, 0.05)
    keywords = volume.keywords | {"nu": nu, "barrier": "barrier" in law}
    p = put(Problem(body, kind, material(E=1.0, **keywords)), wave(0.03), 0.3)
    r = p.x.duplicate()
    energy = p.energy(p.x)
    p.gradient(p.x, r)
    p.jacobian(p.x, "exact")

    Q, values = p.saddle_point.Q, p.saddle_point.pressure()
    u, pressure = p.u, _dolfinx.function(Q, "p")
    pressure.x.array[:] = values
    mu, local, k = moduli(p)
    mu, local, compliance = (
        _dolfinx.constant(body.domain, np.array(c)) for c in (mu, local, 1 / k)
    )
    F = ufl.Identity(3) + ufl.grad(u)
    dual = pressure + compliance / 2 * pressure**2
    dx = ufl.dx(metadata={"quadrature_degree": kind.quadrature})
    L = (volume.rest(F, mu, local) + pressure * ufl.det(F) - dual) * dx
    assert energy == pytest.approx(_dolfinx.assemble_scalar(_dolfinx.form(L)), rel=1e-12)

    n, scale = 3 * _dolfinx.num_nodes(p.V)[0], p.material.expression.E / p.length
    tests, trials = [[f(V) for V in (p.V, Q)] for f in (ufl.TestFunction, ufl.TrialFunction)]
    first = [ufl.derivative(L, w, v) for w, v in zip((u, pressure), tests, strict=True)]
    parts = [r.array_r[:n], r.array_r[n:] / scale]
    for V, form, part in zip((p.V, Q), first, parts, strict=True):
        expected = _dolfinx.create_vector(V)
        _dolfinx.assemble_vector(expected, _dolfinx.form(form))
        assert norm(comm, part - expected.array) <= 1e-12 * expected.norm()

    found, global_u = dense(p.A), comm.allgather(n)
    sizes = comm.allgather((n, p.x.getLocalSize() - n))
    starts = np.cumsum([0, *(a + b for a, b in sizes)])
    rows_u = np.concatenate([s + np.arange(a) for s, (a, _) in zip(starts, sizes, strict=False)])
    rows_p = np.setdiff1d(np.arange(len(found)), rows_u)
    assert len(rows_u) == sum(global_u)
    for a, (rows, one) in enumerate(zip((rows_u, rows_p), (1, scale), strict=True)):
        for b, (columns, other) in enumerate(zip((rows_u, rows_p), (1, scale), strict=True)):
            form = ufl.derivative(first[a], (u, pressure)[b], trials[b])
            part = found[np.ix_(rows, columns)] / one / other
            if a == b == 1 and nu == 0.5:
                assert not part.any()
                continue
            compiled = _dolfinx.form(form)
            matrix = _dolfinx.create_matrix(compiled)
            _dolfinx.assemble_matrix(matrix, compiled)
            expected = dense(matrix)
            assert abs(part - expected).max() <= 1e-12 * abs(expected).max()
