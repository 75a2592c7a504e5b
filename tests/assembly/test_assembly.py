"""The assembled energy, residual and filtered Jacobian, against FFCx's, numpy's, and each other."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from bodies import (
    MATERIALS,
    POINTWISE,
    Hold,
    constrained,
    cube,
    free_components,
    norm,
    pairs,
    problem,
    rows,
    set_values,
    wave,
)

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS

mpi = pytest.mark.mpi
#: Those of the stretches, whose UFL forms test_ufl_stretches.py compares, are left out.
OF_INVARIANTS = [name for name in MATERIALS if name != "fixed_corotational"]
HOLD = [Hold("bottom"), Hold("right", ("x", "z"))]


def free_wave(p, size, shift=0.0):
    """A wave that vanishes where the displacement is prescribed."""
    free = free_components(p)
    return lambda X: wave(size, shift)(X) * free


# --- against ufl.derivative, FFCx and dolfinx's assembler ----------------------------------------


@pairs(POINTWISE, materials=OF_INVARIANTS)
def test_what_ufl_derives_is_what_the_kernels_assemble(comm, element, name):
    """27 or 48 bent cells: the last batch of 8 is not full."""
    kind = ELEMENTS[element]
    p = problem(
        cube(comm, kind.cell, 3 if kind.cell == "hexahedron" else 2, 0.06), element, name, hold=HOLD
    )
    set_values(p, wave(0.03))
    u, v, w = p.u, ufl.TestFunction(p.V), ufl.TrialFunction(p.V)
    dx = ufl.dx(metadata={"quadrature_degree": kind.quadrature})
    options = {"cffi_extra_compile_args": ["-O1"]}
    psi = p.regions[0].material.ufl(ufl.variable(ufl.Identity(3) + ufl.grad(u))) * dx
    forms = psi, ufl.derivative(psi, u, v), ufl.derivative(ufl.derivative(psi, u, v), u, w)
    energy, residual, jacobian = (_dolfinx.form(form, options) for form in forms)
    assert p.energy(p.x) == pytest.approx(_dolfinx.assemble_scalar(energy), rel=1e-12)

    reactions, r, expected = (_dolfinx.create_vector(p.V) for _ in range(3))
    _dolfinx.assemble_vector(expected, residual)
    p.gradient(p.x, reactions)
    assert norm(comm, reactions.array - expected.array) <= 1e-12 * expected.norm()
    p.residual(p.x, r)
    expected.array[constrained(p)] = 0
    assert norm(comm, r.array - expected.array) <= 1e-12 * expected.norm()
    assert not r.array[constrained(p)].any()

    p.jacobian(p.x, "exact")
    full = _dolfinx.create_matrix(jacobian)
    _dolfinx.assemble_matrix(full, jacobian)
    free = ~np.concatenate(comm.allgather(constrained(p)))
    mine = ~constrained(p)
    wanted, got = rows(full), rows(p.A)
    assert norm(comm, (got - wanted)[mine][:, free].data) <= 1e-12 * norm(comm, wanted.data)
    # Prescribed rows and columns: nothing but one positive number on the diagonal.
    diagonal = np.concatenate(comm.allgather(p.A.getDiagonal().array))[~free]
    assert (diagonal > 0).all() and np.ptp(diagonal) == 0
    outside = got[constrained(p)]
    assert not got[mine][:, ~free].data.any() and not outside[:, free].data.any()
    assert np.count_nonzero(outside.data) == constrained(p).sum()


# --- ranks ---------------------------------------------------------------------------------------


def numbers(comm, element, name, cells):
    """Energies and norms that any number of ranks must agree on."""
    p = problem(cube(comm, ELEMENTS[element].cell, cells, 0.05), element, name, hold=HOLD)
    set_values(p, wave(0.04))
    r = p.x.duplicate()
    p.residual(p.x, r)
    found = [p.energy(p.x), r.norm(), *p.measures(p.x).values(), p.length]
    for choice in ("exact", "clamp"):
        found.append(p.jacobian(p.x, choice))
        found += [p.A.norm(PETSc.NormType.FROBENIUS), p.A.norm(PETSc.NormType.INFINITY)]
        d = set_values(p, wave(1.0, 0.2), p.x.duplicate())
        p.A.mult(d, r)
        found += [r.norm(), r.dot(d)]
    return found


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("cells", [1, 3])
@pytest.mark.parametrize(
    "element, name",
    [
        ("Q1", "stable_neo_hookean"),
        ("Q2", "stable_neo_hookean"),
        ("P1", "fixed_corotational"),
        ("P2", "fixed_corotational"),
    ],
)
def test_any_number_of_ranks_gives_the_same_numbers(comm, element, name, cells):
    """With one cell, all ranks but one have none."""
    alone = numbers(MPI.COMM_SELF, element, name, cells)
    assert numbers(comm, element, name, cells) == pytest.approx(alone, rel=1e-12)


# --- what PETSc sees -----------------------------------------------------------------------------


@pytest.mark.one_debian("ranks")
@mpi
def test_a_direct_solver_notices_new_values(comm):
    """The matrix is filled behind PETSc's back; a factorisation must not outlive it."""
    p = problem(cube(comm, "hexahedron", 2), "Q1", hold=HOLD)
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(p.A)
    if comm.size == 1:
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
    else:
        ksp.setType("cg")
        ksp.setTolerances(rtol=1e-13, atol=0)
        ksp.getPC().setType("bjacobi")
    b, x, Ax = (p.x.duplicate() for _ in range(3))
    set_values(p, free_wave(p, 1.0), b)
    solutions = []
    for size in (0.0, 0.05):
        set_values(p, wave(size))
        p.jacobian(p.x, "clamp")
        ksp.solve(b, x)
        p.A.mult(x, Ax)
        Ax.axpy(-1, b)
        assert Ax.norm() <= 1e-10 * b.norm()
        solutions.append(x.copy())
    solutions[1].axpy(-1, solutions[0])
    assert solutions[1].norm() > 1e-3 * solutions[0].norm()


@pytest.mark.one_debian
@mpi
def test_out_of_domain_is_infinite_energy_and_nothing_is_nan(comm):
    p = problem(cube(comm, "hexahedron", 2), "Q1", "neo_hookean", hold=HOLD)
    set_values(p, wave(0.6))
    assert p.measures(p.x)["min_J"] < 0
    assert p.energy(p.x) == np.inf
    r = p.x.duplicate()
    p.residual(p.x, r)
    assert np.isfinite(r.norm())
    p.jacobian(p.x, "clamp")
    assert np.isfinite(p.A.norm())
