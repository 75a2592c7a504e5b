"""Choose whether the cell pressures of Q1P0 and P2P0 are eliminated or unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh import _dolfinx, solver
from fem_snh.assembly.elements import with_cell_pressures
from fem_snh.assembly.unknowns import create_unknowns
from fem_snh.errors import BadInput, bad_value
from fem_snh.problem.problem import Problem
from fem_snh.steps.cell_pressures import CellPressures

#: Poisson's ratio from which the mixed problem is the faster one
#: (docs/results/elements_cell_pressures.md).
_MIXED_NU = 0.499
#: PETSc options that choose the solver of the condensed problem.
_SOLVER_OPTIONS = ("ksp_type", "pc_type", "snes_hessian", "snes_globalization", "snes_lbfgs_max_it")


class Condensation(NamedTuple):
    """A choice, made by the user or by the program.

    Attributes
    ----------
    pressures : CellPressures or None
        The mixed problem; None if the pressures are eliminated.
    reason : str
        Why the program chose so; empty if the user did, or for an element without cell pressures.
    """

    pressures: CellPressures | None = None
    reason: str = ""


def choose_condensation(
    wanted: bool | None,
    problem: Problem,
    make_mixed: Callable[[], Problem],
    why_condensed: str,
    prefix: str = solver.PREFIX,
) -> Condensation:
    """Return the choice for a problem. Collective.

    Parameters
    ----------
    wanted : bool or None
        Whether the user wants the pressures eliminated; None leaves it to the program.
    problem : Problem
        The condensed problem.
    make_mixed : callable
        ``make_mixed()`` returns the same problem with unknown pressures.
    why_condensed : str
        Why the program eliminates them at any Poisson's ratio; empty if it need not.
    prefix : str, optional
        Prefix of the solver's options in PETSc's database.

    Raises
    ------
    BadInput
        On every rank, if the user wants unknown pressures, and a material has no volume term whose
        pressure can be inverted.
    """
    if wanted is not None:
        return Condensation(None if wanted else CellPressures(problem, make_mixed(), prefix))
    if problem.element.volume != "mean" or not problem.regions:
        return Condensation()
    nu = max(region.material.numbers.nu for region in problem.regions)
    if nu < _MIXED_NU:
        return Condensation(reason=f"nu = {nu:g} < {_MIXED_NU}: the condensed problem is cheaper")
    if why_condensed:
        return Condensation(reason=why_condensed)
    try:
        pressures = CellPressures(problem, make_mixed(), prefix)
    except BadInput as error:
        return Condensation(reason=str(error))
    return Condensation(pressures, f"nu = {nu:g} >= {_MIXED_NU}: few iterations on every mesh")


def program_pressures(
    wanted: bool | None, problem: Problem, choices: Mapping[str, object], prefix: str
) -> CellPressures | None:
    """Return the mixed problem of a dolfinx program, if it is chosen. Collective.

    Parameters
    ----------
    wanted, problem, prefix
        As for `choose_condensation`.
    choices : mapping
        As for `chosen_for_condensed`.

    Raises
    ------
    BadInput
        On every rank, if the user wants unknown pressures and the problem cannot have them.
    """
    if wanted is False and problem.element.volume != "mean":
        accepted = f"None: {problem.element.name} has no cell pressures"
        raise bad_value("static_condensation", wanted, accepted)
    why_condensed = chosen_for_condensed(prefix, choices)
    stateful = [t.name for t in problem.terms[1:] if not t.stateless]
    if stateful:
        why_condensed = f"the term '{stateful[0]}' has a state of its own"
        if wanted is False:
            raise bad_value("static_condensation", wanted, f"None, as {why_condensed}")

    def make_mixed() -> Problem:
        """Return a problem with a displacement of its own, and the same conditions and terms."""
        element, u = with_cell_pressures(problem.element), _dolfinx.function(problem.V, "mixed")
        given = element, problem.regions, problem.dirichlet, problem.terms[1:]
        return Problem(create_unknowns(u, element), *given)

    return choose_condensation(wanted, problem, make_mixed, why_condensed, prefix).pressures


def chosen_for_condensed(prefix: str, choices: Mapping[str, object]) -> str:
    """Return the choice of the user's that is one of the condensed problem's solver, in words.

    Parameters
    ----------
    prefix : str
        The prefix of the solver's options.
    choices : mapping
        Values of the keys ``hessian`` and ``globalization``; None for none.
    """
    database = PETSc.Options(prefix)
    named = [name for name in _SOLVER_OPTIONS if database.hasName(name)]
    named += [key for key, value in choices.items() if value is not None]
    return f"{named[0]} was chosen, for the condensed problem" if named else ""
