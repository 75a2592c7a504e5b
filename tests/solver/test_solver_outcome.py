"""The end of a solve: inexact directions that are improved, reasons in words, counts."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import Press, converged, unit_cube

import fem_snh
from fem_snh import solver

pytestmark = pytest.mark.mpi

SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.495)
_Reason = PETSc.SNES.ConvergedReason


def fibres(comm: Any, stretch: float, stiffness: float, cells: int, **keys: Any) -> Any:
    """Return the problem of a cube with stiff fibres at 30 degrees, stretched; P2P1."""
    body = Press(unit_cube(comm, cells, "tetrahedron"), degree=2, height=stretch)
    a = ufl.as_vector([np.sin(0.5), 0.0, np.cos(0.5)])
    k = fem.Constant(body.domain, stiffness)  # of the same form: it is compiled once
    fibre = k / 2 * (ufl.inner(body.F * a, body.F * a) - 1) ** 2 * ufl.dx
    return fem_snh.NonlinearProblem(
        body.u, {SNH: ufl.dx}, bcs=body.bcs, terms=[fibre], element="P2P1", **keys
    )


@pytest.mark.parametrize(("stretch", "stiffness"), [(0.2, 20.0), (0.3, 50.0), (0.5, 10.0)])
def test_an_inexact_direction_that_does_not_descend_is_improved(
    comm: Any, stretch: float, stiffness: float
) -> None:
    """The state is that of a solve with sparse factors, in a few iterations more."""
    direct = {"snes_linear_solver": "direct", "snes_scaled_tol": 1e-9}
    counts, states = [], []
    for given in ({"snes_scaled_tol": 1e-9}, direct):
        problem = fibres(comm, stretch, stiffness, 1, petsc_options=given)
        problem.solve()
        assert converged(problem), problem.reason
        assert problem.reason == "CONVERGED_FNORM_ABS"
        counts.append(len(problem.solver.getPythonContext().history))
        states.append(problem.x.copy())
    assert counts[0] <= counts[1] + 5
    states[0].axpy(-1.0, states[1])
    assert states[0].norm() < 1e-6 * states[1].norm()


@pytest.mark.one_debian("serial")
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_the_solver_counts_linear_iterations(comm: Any, element: str) -> None:
    """As many as its KSP counts; with sparse factors one for each Newton iteration."""
    cell, degree = ("hexahedron", 1) if element == "Q1" else ("tetrahedron", 2)
    for choice in ("automatic", "direct"):
        body = Press(unit_cube(comm, 2, cell), degree=degree, height=-0.05)
        problem = fem_snh.NonlinearProblem(
            body.u, {SNH: ufl.dx}, bcs=body.bcs, element=element, predictor="none",
            hessian="clamp", petsc_options={"snes_linear_solver": choice},
        )  # fmt: skip
        assert problem.solver.getLinearSolveIterations() == 0
        counted: list[int] = []
        ksp = problem.solver.getKSP()
        ksp.setMonitor(lambda ksp, its, norm, counted=counted: counted.append(its))
        problem.solve()
        assert converged(problem)
        newton = problem.solver.getIterationNumber()
        expected = newton if choice == "direct" else sum(its > 0 for its in counted)
        assert problem.solver.getLinearSolveIterations() == expected >= newton > 0
        assert isinstance(problem.solver, solver.snes.NewtonSNES)


@pytest.mark.one_debian("ranks")
def test_a_linearised_step_has_a_reason(comm: Any) -> None:
    for few, reason in (({}, "CONVERGED_ITS"), ({"ksp_max_it": 1}, "DIVERGED_LINEAR_SOLVE")):
        body = Press(unit_cube(comm, 2), height=0.0)
        options = {"ksp_type": "cg", "pc_type": "none", **few}
        problem = fem_snh.DynamicProblem(
            body.u, {SNH: ufl.dx}, {SNH: 1.0}, "semi_implicit", duration=1.0, bcs=body.bcs,
            terms=[-ufl.inner(ufl.as_vector([0.01, 0.02, 0.03]), body.u) * ufl.dx],
            petsc_options=options,
        )  # fmt: skip
        assert problem.step(0.1) == (not few), problem.reason
        assert problem.reason.split(":")[0] == reason
        assert problem.solver.getConvergedReason() == getattr(_Reason, reason)
        if few:
            assert "relative residual" in problem.reason and "> ksp_rtol = 0.001" in problem.reason
