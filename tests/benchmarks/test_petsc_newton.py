"""The benchmark that runs PETSc's trust regions beside ours."""

from __future__ import annotations

import pytest

from benchmarks import petsc_newton
from fem_snh.errors import BadInput


def test_petsc_methods_beside_ours() -> None:
    found = {
        row["method"]: row for row in petsc_newton.rows(cases="quarter turn", nus="0.3", cells="3")
    }
    assert set(found) == {"ours", "newtontr", "newtontr+stcg", "bntr", "bntr+icc"}
    assert found["ours"]["converged"] and found["bntr"]["converged"]
    for row in found.values():
        assert row["reason"] and (row["residual"] <= 1e-7 or not row["converged"])
    assert found["bntr"]["energy"] == pytest.approx(found["ours"]["energy"], rel=1e-5)


def test_unknown_method() -> None:
    with pytest.raises(BadInput, match=r"method = 'bnrt': .*did you mean 'bntr'"):
        next(petsc_newton.rows(methods="bnrt", cells="2"))
