"""PETSc's C interface: the size of its integers."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

from fem_snh import _petsc
from fem_snh.errors import BadInput


def test_64_bit_integers_are_bad_input(monkeypatch):
    A = PETSc.Mat().createAIJ((3, 3), nnz=1, comm=PETSc.COMM_SELF)
    A.setUp()
    A.assemble()
    monkeypatch.setattr(PETSc, "IntType", np.int64)
    _petsc._library.cache_clear()
    with pytest.raises(BadInput, match=r"^PetscInt = 64 bits: expected 32[^\n]*$"):
        with _petsc.aij_blocks(A):
            pass
    monkeypatch.undo()
    with _petsc.aij_blocks(A) as (block,):
        assert block.values
