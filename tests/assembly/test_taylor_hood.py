"""Energy, residual and Jacobian of Taylor-Hood elements, against forms that UFL derives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl
from bodies import Hold, create_problem, cube, dense, norm, wave
from volume_energies import ENERGIES, KEYWORDS, TAYLOR_HOOD, moduli, mpi, set_state

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.kernels.material import material

# --- Taylor-Hood, derived by UFL -----------------------------------------------------------------


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("element", TAYLOR_HOOD)
@pytest.mark.parametrize(
    "name, nu",
    [("stable_neo_hookean", nu) for nu in (0.1, 0.49, 0.4999, 0.5)]
    + [("stable_neo_hookean+barrier", 0.3)],
)
def test_taylor_hood_is_what_ufl_derives(comm, element, name, nu):
    """psi' + p J - U*(p), U* = p J(p) - U(J(p)), J(p) = 1 + p/k; at nu = 0.5 U* = p."""
    kind, volume = ELEMENTS[element], ENERGIES[name]
    # Rules that are the same for FFCx whatever degree an element has by default.
    kind = replace(kind, quadrature={"tetrahedron": 2, "hexahedron": 5}[kind.cell])
    body = cube(comm, kind.cell, 2, 0.05)
    keywords = KEYWORDS[name] | {"nu": nu, "barrier": "barrier" in name}
    p = set_state(create_problem(body, kind, material(E=1.0, **keywords)), wave(0.03), 0.3)
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

    n, scale = 3 * _dolfinx.num_nodes(p.V)[0], p.regions[0].material.expression.E / p.length
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


@pytest.mark.one_debian("ranks")
@mpi
def test_a_body_without_free_nodes_has_a_definite_schur_approximation(comm):
    body = cube(comm, "tetrahedron", 1)
    made = material("stable_neo_hookean", nu=0.5)
    p = create_problem(body, ELEMENTS["P2P1"], made, hold=[Hold("body")])
    p.jacobian(p.x, "clamp")
    with np.errstate(all="raise"):
        p.saddle_point.update_schur_approximation(p.A)
    assert len(p.constrained_dofs) == 3 * len(p.coordinates)
    assert np.linalg.eigvalsh(dense(p.saddle_point.schur_approximation))[-1] < 0
