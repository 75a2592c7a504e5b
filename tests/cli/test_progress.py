"""The lines that a run prints, and those of a run that is expected to fail."""

from __future__ import annotations

from mpi4py import MPI

import pytest

import fem_snh

REASON = "one Newton iteration is too few"


def printed(capsys: pytest.CaptureFixture[str], **options: object) -> tuple[bool, list[str]]:
    """Return whether a run of the scene ``twist`` converged, and the lines that it printed."""
    result = fem_snh.run("twist", comm=MPI.COMM_SELF, cells=2, steps=1, angle=0.2, **options)
    return result.converged, capsys.readouterr().out.splitlines()


def test_the_first_line_names_the_hessian_and_the_globalization(
    capsys: pytest.CaptureFixture[str],
) -> None:
    converged, lines = printed(capsys, hessian="clamp", globalization="linesearch")
    assert converged
    material = "stable_neo_hookean (eq. 13 of Smith et al. 2018), E = 1, nu = 0.49"
    assert lines[0].startswith(f"twist: {material}; 8 Q1 cells, 81 dofs")
    assert lines[0].endswith("; clamp Hessian, linesearch; 1 rank(s)")
    assert lines[-1].startswith("  converged in ")


def test_a_failure_that_is_expected(capsys: pytest.CaptureFixture[str]) -> None:
    converged, lines = printed(capsys, expected=REASON, petsc={"snes_max_it": 1})
    assert not converged
    assert lines[1] == f"  expected to fail: {REASON}"
    assert lines[-1].startswith("  failed as expected: stopped at load ")
