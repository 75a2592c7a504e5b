"""The parts of an assembled matrix, against PETSc's own extraction of them."""

from __future__ import annotations

from itertools import product

from mpi4py import MPI
from petsc4py import PETSc

import pytest
from bodies import wave
from volume_energies import mixed_problem, mpi, set_state

from fem_snh.linalg.block_matrix import Submatrix


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("element", ["Q2Q1", "P2P0"])
def test_values_are_those_of_petsc(comm, element):
    """The blocks, also after the matrix has changed."""
    problem = set_state(mixed_problem(comm, element), wave(0.05))
    sets, A = problem.saddle_point.index_sets, problem.A
    parts = {fields: Submatrix(A, sets, *fields) for fields in product("up", "up")}
    for filter in ("exact", "clamp"):
        problem.jacobian(problem.x, filter)
        for (rows, columns), part in parts.items():
            part.update(A)
            expected = A.createSubMatrix(sets[rows], sets[columns])
            assert expected.norm() > 0
            expected.axpy(-1.0, part.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            assert expected.norm() == 0


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("element", ["Q2Q1", "P2P1", "Q1P0", "P2P0"])
def test_any_number_of_ranks_assembles_the_same_matrix(comm, element):
    """Rows of displacements and of pressures that several ranks contribute to."""

    def norms(ranks):
        problem = set_state(mixed_problem(ranks, element), wave(0.05))
        problem.jacobian(problem.x, "clamp")
        x, y = problem.A.createVecs()
        set_state(problem, wave(0.3), push=0.5).x.copy(x)
        problem.A.mult(x, y)
        parts = [
            problem.A.createSubMatrix(of, of) for of in problem.saddle_point.index_sets.values()
        ]
        return [problem.A.norm(), *(part.norm() for part in parts), y.norm(), y.dot(x)]

    assert norms(comm) == pytest.approx(norms(MPI.COMM_SELF), rel=1e-12)
