"""Choose whether the cell pressures of Q1P0 and P2P0 are eliminated or unknown."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.errors import BadInput
from fem_snh.fem.elements import ELEMENTS
from fem_snh.fem.problem import Problem
from fem_snh.runs.cell_pressures import CellPressures
from fem_snh.scenes import Scene, why_condensed

#: Poisson's ratio from which the mixed problem is the faster one
#: (docs/results/elements_cell_pressures.md).
_MIXED_NU = 0.499
#: PETSc options that choose the solver of the condensed problem.
_SOLVER_OPTIONS = ("ksp_type", "pc_type", "snes_hessian", "snes_globalization", "snes_lbfgs_max_it")


class Condensation(NamedTuple):
    """A choice, made by the scene or by the program.

    Attributes
    ----------
    pressures : CellPressures or None
        The mixed problem; None if the pressures are eliminated.
    reason : str
        Why the program chose so; empty if the scene did, or for an element without cell pressures.
    """

    pressures: CellPressures | None = None
    reason: str = ""


def choose_condensation(
    scene: Scene, problem: Problem, make_mixed: Callable[[], Problem]
) -> Condensation:
    """Return the choice for a scene; ``make_mixed()`` returns its mixed problem. Collective.

    Raises
    ------
    BadInput
        On every rank, if the scene asks for unknown pressures and its material has no volume term
        whose pressure can be inverted.
    """
    if scene.static_condensation is not None:
        mixed = not scene.static_condensation
        return Condensation(CellPressures(problem, make_mixed()) if mixed else None)
    if ELEMENTS[scene.element].volume != "mean":
        return Condensation()
    nu = max(material.nu for material in scene.materials)
    if nu < _MIXED_NU:
        return Condensation(reason=f"nu = {nu:g} < {_MIXED_NU}: the condensed problem is cheaper")
    if reason := why_condensed(scene) or _why_chosen(scene):
        return Condensation(reason=reason)
    try:
        pressures = CellPressures(problem, make_mixed())
    except BadInput as error:
        return Condensation(reason=str(error))
    return Condensation(pressures, f"nu = {nu:g} >= {_MIXED_NU}: few iterations on every mesh")


def _why_chosen(scene: Scene) -> str:
    """Return why a scene is better solved condensed; empty if it is not."""
    if scene.start is not None:
        return "a start far from equilibrium, where the energy has to be minimised"
    database = PETSc.Options(solver.PREFIX)
    named = [name for name in _SOLVER_OPTIONS if database.hasName(name)]
    named += [key for key in ("hessian", "globalization") if getattr(scene, key) is not None]
    return f"{named[0]} was chosen, for the condensed problem" if named else ""
