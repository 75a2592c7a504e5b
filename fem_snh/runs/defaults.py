"""The entry ``defaults`` of run.json: what the user left to the program, with reasons."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.assembly.elements import Element
from fem_snh.problem.problem import Problem
from fem_snh.scenes import Scene
from fem_snh.steps.condensation import Condensation

#: Why a Hessian is ``adaptive`` (docs/results/which_hessian.md).
_HESSIAN = (
    "exact while the linear solver finds it positive definite, which takes the fewest Newton "
    "iterations; filtered where it is not"
)
#: Reasons of a globalization.
_NAMED_HESSIAN = "the Hessian was chosen, and a line search is the method that it is known with"
_MINIMUM = "the problem minimises an energy, so that negative curvature can be followed"
_SADDLE = "Taylor-Hood elements give a saddle-point problem, which has no energy to minimise"
_FORCES = "a force without an energy: there is nothing to minimise"


def describe_condensation(about: dict[str, Any], element: Element, chosen: Condensation) -> None:
    """Add ``static_condensation`` to the record of an element with cell pressures.

    Where the pressures are unknowns, the linear solver is that of their problem.
    """
    if element.volume != "mean":
        return
    about["static_condensation"] = condensed = chosen.pressures is None
    if chosen.pressures is not None:
        snes = chosen.pressures.snes
        about["linear_solver"] = name = solver.linear_solver_name(snes)
        if reason := snes.getPythonContext().linear_choice.reason:
            about["defaults"]["linear_solver"] = {"value": name, "reason": reason}
    if chosen.reason:
        entry = {"value": condensed, "reason": chosen.reason}
        about["defaults"]["static_condensation"] = entry


def describe_defaults(scene: Scene, problem: Problem, snes: PETSc.SNES) -> dict[str, object]:
    """Return ``{choice: {"value", "reason"}}`` of what neither scene nor PETSc options set."""
    database, context = PETSc.Options(solver.PREFIX), snes.getPythonContext()
    found: dict[str, object] = {}

    def add(key: str, value: object, reason: str) -> None:
        found[key] = {"value": value, "reason": reason}

    named = scene.hessian is not None or database.hasName("snes_hessian")
    if not named:
        add("hessian", context.options["snes_hessian"], _HESSIAN)
    if scene.globalization is None and not database.hasName("snes_globalization"):
        reason = _MINIMUM if problem.has_energy else _FORCES
        reason = _SADDLE if problem.saddle_point else reason
        reason = _NAMED_HESSIAN if named else reason
        add("globalization", context.options["snes_globalization"], reason)
    if context.linear_choice.reason:
        add("linear_solver", solver.linear_solver_name(snes), context.linear_choice.reason)
    if scene.quadrature is None:
        add("quadrature", problem.element.quadrature, f"the degree of {scene.element}")
    return found
