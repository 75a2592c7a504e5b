"""Products of a saddle-point problem's matrix with vectors that the preconditioner has computed."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import wave
from volume_energies import mixed_problem, mpi, set_state

from fem_snh import solver
from fem_snh.runs import run
from fem_snh.solver import saddle_point
from fem_snh.solver.block_triangular import BlockProduct


def _preconditioned(comm, element, options=None):
    """Return a problem, its preconditioner, a random vector and the preconditioned vector."""
    problem = set_state(mixed_problem(comm, element), wave(0.05))
    problem.jacobian(problem.x, "clamp")
    problem.saddle_point.update_schur_approximation(problem.A)
    ksp = solver.create(problem).getKSP()
    blocks = ksp.getPC().getPythonContext()
    for option, value in (options or {}).items():
        blocks.u.setTolerances(**{option: value})
    ksp.setOperators(problem.A, problem.A)
    ksp.setUp()
    f, z = problem.x.duplicate(), problem.x.duplicate()
    f.array[:] = np.random.default_rng(comm.rank).standard_normal(f.getLocalSize())
    f.array[problem.constrained_dofs] = 0.0
    ksp.getPC().apply(f, z)
    return problem, ksp, f, z


def _products(problem, blocks, x):
    """Return the product of the blocks' matrix and that of A with a vector."""
    found, expected = x.duplicate(), x.duplicate()
    blocks.operator.mult(x, found)
    problem.A.mult(x, expected)
    return found.array, expected.array


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q2Q1", "P2P1", "Q1P0", "P2P0"])
def test_the_known_product_is_that_of_the_matrix(comm, element):
    """To single precision; where the vector or the matrix has changed, to the last bit."""
    problem, ksp, _, z = _preconditioned(comm, element)
    blocks = ksp.getPC().getPythonContext()
    found, expected = _products(problem, blocks, z)
    assert not np.array_equal(found, expected)
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())
    copy = z.copy()
    assert np.array_equal(*_products(problem, blocks, copy))
    z.scale(2.0)
    assert np.array_equal(*_products(problem, blocks, z))


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("applied", ["before", "after"])
def test_a_changed_matrix_makes_the_product_unknown(comm, applied):
    """Also where the preconditioner of the former one is kept, and applied once more."""
    problem, ksp, f, z = _preconditioned(comm, "P2P0")
    problem.jacobian(problem.x, "exact")
    if applied == "after":
        ksp.getPC().setReusePreconditioner(True)
        ksp.getPC().apply(f, z)
    assert np.array_equal(*_products(problem, ksp.getPC().getPythonContext(), z))


@pytest.mark.one_debian
@mpi
def test_a_load_step_takes_the_same_path(monkeypatch):
    """As many iterations and the same energy as with exact products, of which few are left."""
    known, steps, settings = [], [], {"steps": 1, "stretch": 1.2, "progress": False}
    multiply = BlockProduct.mult

    def counted(self, mat, x, y):
        known.append((x.handle, x.stateGet()) == self._known)
        multiply(self, mat, x, y)

    monkeypatch.setattr(BlockProduct, "mult", counted)
    for least in (saddle_point._KNOWN_PRODUCT_RTOL, 1.0):
        monkeypatch.setattr(saddle_point, "_KNOWN_PRODUCT_RTOL", least)
        result = run("stretch", element="P2P0", cells=4, nu=0.4999, **settings)
        steps += result.steps
    assert all(known) and len(known) >= 0.8 * steps[0]["linear"]
    assert [steps[0][key] for key in ("newton", "linear")] == [
        steps[1][key] for key in ("newton", "linear")
    ]
    assert steps[0]["energy"] == pytest.approx(steps[1]["energy"], rel=1e-9)
