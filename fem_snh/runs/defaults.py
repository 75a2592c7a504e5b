"""The entry ``defaults`` of run.json: what the user left to the program, with reasons."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.fem.elements import Element
from fem_snh.fem.problem import Problem
from fem_snh.runs.condensation import Condensation
from fem_snh.scenes import Scene

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
#: Reasons of a linear solver.
_SSOR = (
    "a minimisation problem with an assembled matrix: least time and memory on solid bodies; "
    "a direct solver can be faster on a single layer of cells"
)
_BLOCKS = "Taylor-Hood elements: the blocks of displacement and pressure have solvers of their own"
_RANK_ONE = "a load adds matrices of rank one, which are applied without being assembled"


def describe_condensation(about: dict[str, Any], element: Element, chosen: Condensation) -> None:
    """Add ``static_condensation`` to the record of an element with cell pressures."""
    if element.volume != "mean":
        return
    about["static_condensation"] = condensed = chosen.pressures is None
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
        # An alias of the Hessian (`fem_snh.choices.replace_alias`) names both.
        if context.options["snes_globalization"] == "linesearch" or not named:
            reason = _NAMED_HESSIAN if named else reason
            add("globalization", context.options["snes_globalization"], reason)
    if not (database.hasName("ksp_type") or database.hasName("pc_type")):
        reason = _RANK_ONE if problem.operator != problem.A else _SSOR
        reason = _BLOCKS if problem.saddle_point else reason
        add("linear_solver", solver.linear_solver_name(snes), reason)
    if scene.quadrature is None:
        add("quadrature", problem.element.quadrature, f"the degree of {scene.element}")
    return found
