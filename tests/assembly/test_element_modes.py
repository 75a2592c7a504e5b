"""The modes of every element at rest: rigid motions, and no spurious ones."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import cube, dense, one_cell
from element_theory import THEORY, poissons, problem

from fem_snh.assembly.elements import ELEMENTS

# --- modes at rest -------------------------------------------------------------------------------


def modes(element, nu, body, quadrature):
    """How many eigenvalues of the stiffness at rest are negative, and zero."""
    kind = ELEMENTS[element]
    if body == "cell":
        made = one_cell(MPI.COMM_SELF, kind.cell)
    else:
        made = cube(MPI.COMM_SELF, kind.cell, 2, 0.05)
    p = problem(made, element, nu, quadrature)
    p.jacobian(p.x, "exact")
    values = np.linalg.eigvalsh(dense(p.A))
    zero = abs(values) <= 1e-12 * values[-1]
    pressures = len(p.x.array) - len(p.u.x.array)
    assert abs(values[~zero]).min() > 1e-8 * values[-1]  # no eigenvalue is in between
    return int((values[~zero] < 0).sum()) - pressures, int(zero.sum())


@pytest.mark.one_debian
@poissons(0.3, 0.4999)
@pytest.mark.parametrize("body", ["cell", "patch"])
def test_rest_has_the_rigid_motions_and_no_spurious_modes(element, nu, body):
    """Six zeros and, with a pressure, a negative eigenvalue for each of its unknowns.

    With the default quadrature and, of one cell, which is the hardest, any other that will do.
    """
    kind, theory = ELEMENTS[element], THEORY[element]
    more = range(theory.least, kind.quadrature + 3) if body == "cell" and nu == 0.3 else ()
    for degree in sorted({*more, theory.least, kind.quadrature}):
        assert modes(element, nu, body, degree) == (0, 6)


@pytest.mark.one_debian
@pytest.mark.parametrize("element", [name for name, theory in THEORY.items() if theory.least > 1])
def test_one_degree_less_has_spurious_modes(element):
    """So that ``least`` is the least; no rule has degree 0."""
    assert modes(element, 0.3, "cell", THEORY[element].least - 1) != (0, 6)
