"""Forcing terms: the relative tolerances of linear solves, and the accuracy that they cost."""

from __future__ import annotations

from petsc4py import PETSc

import pytest
from solver_problems import options, solve, twist

from fem_snh.solver.step import ForcingTerm


def tolerances(forcing: ForcingTerm, norms: list[float]) -> list[float]:
    """The relative tolerance of the linear solve at each of these norms of the residual."""
    ksp, found = PETSc.KSP().create(PETSc.COMM_SELF), []
    ksp.setTolerances(rtol=1e-3)
    for norm in norms:
        forcing.update(norm)
        with forcing.applied(ksp):
            found.append(ksp.getTolerances()[0])
    return found


def test_choice_2_of_eisenstat_and_walker() -> None:
    """0.9 (r_k / r_k-1)^2, between ksp_rtol and the maximum."""
    assert tolerances(ForcingTerm(0.1), [1.0, 0.2, 0.05, 0.05]) == pytest.approx(
        [0.1, 0.036, 0.05625, 0.1]
    )
    assert tolerances(ForcingTerm(0.1), [1.0, 1e-3]) == pytest.approx([0.1, 1e-3])
    assert tolerances(ForcingTerm(0.0, 0.5), [1.0, 1e-3]) == [1e-3, 1e-3]


def test_the_safeguard_stops_at_its_part_of_the_tolerance() -> None:
    found = tolerances(ForcingTerm(5e-3, 0.25e-7), [1.0, 1e-2, 1e-6, 1e-7])
    assert found == pytest.approx([5e-3, 1e-3, 0.025, 0.1])


@pytest.mark.one_debian("ranks")
@pytest.mark.mpi
def test_the_safeguard_saves_linear_iterations_and_keeps_the_tolerance(comm) -> None:
    ends, linear = [], []
    for safeguard in (0.0, 0.25):
        p = twist(comm, cells=4, angle=0.3)
        with options(snes_forcing_safeguard=safeguard):
            snes, context = solve(p)
        assert snes.getConvergedReason() > 0
        ends.append(p.x.array.copy())
        linear.append(sum(i.linear for i in context.history))
        assert snes.getFunctionNorm() <= context.scaled_tolerance
    assert linear[1] < linear[0]
    assert ends[1] == pytest.approx(ends[0], abs=1e-5)
