"""The stiffness summed over one direction after the other, against the sum over all points."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import Hold, cube, norm, rows, wave
from element_theory import problem
from volume_energies import set_state

from fem_snh import _dolfinx
from fem_snh.assembly.cell_loops import TensorBasis
from fem_snh.assembly.elements import ELEMENTS, MAX_QUADRATURE_DEGREE, element

mpi = pytest.mark.mpi


@pytest.mark.parametrize("degree", range(ELEMENTS["Q2"].least, 10))
@pytest.mark.parametrize("name", ["Q2", "Q2Q1"])
def test_products_of_the_basis_are_the_basis(name, degree):
    e = element(name, degree)
    tensor = TensorBasis.of(e)
    points, _ = _dolfinx.quadrature(e.cell, degree)
    value, slope = tensor.basis
    m, n = value.shape
    gradient = np.einsum("ia,jb,kc->ijkabc", slope, value, value).reshape(m**3, n**3)
    wanted = _dolfinx.tabulate_element(e.cell, 2, points, 1)[1]
    assert np.allclose(gradient[tensor.points], wanted[:, tensor.nodes], atol=1e-13)


@mpi
@pytest.mark.parametrize("filter", ["exact", "clamp"])
@pytest.mark.parametrize("quadrature", [4, 5, 7, MAX_QUADRATURE_DEGREE])
@pytest.mark.parametrize("name", ["Q2", "Q2Q1"])
def test_the_order_of_sums_changes_nothing(comm, monkeypatch, name, quadrature, filter):
    matrices = []
    for of in (TensorBasis.of, lambda element: None):
        monkeypatch.setattr(TensorBasis, "of", of)
        hold = [Hold("bottom"), Hold("right", ("x", "z"))]
        p = problem(cube(comm, "hexahedron", 3, 0.06), name, 0.45, quadrature, hold=hold)
        set_state(p, wave(0.1), 0.5)
        p.jacobian(p.x, filter)
        matrices.append(rows(p.A))
    new, old = matrices
    assert norm(comm, (new - old).data) <= 1e-13 * norm(comm, old.data)


def test_elements_without_a_gain_have_no_products():
    assert [name for name, e in ELEMENTS.items() if TensorBasis.of(e)] == ["Q2", "Q2Q1"]
