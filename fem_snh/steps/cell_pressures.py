"""Solve a load step of Q1P0 or P2P0 with cell pressures as unknowns, before the condensed problem.

The condensed energy V U(J_e) of a nearly incompressible cell is a stiff penalty: Newton's method
reaches its minimiser by many short steps, each with an ill-conditioned matrix. With the pressure of
each cell as an unknown (Simo, Taylor & Pister 1985) the equilibria are the same, Newton's method
satisfies the linearised volume constraint, and the linear systems have the form of Taylor-Hood
elements (`fem_snh.solver.saddle_point`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx, solver
from fem_snh.assembly.elements import with_cell_pressures
from fem_snh.assembly.unknowns import create_unknowns
from fem_snh.errors import BadInput, bad_value
from fem_snh.problem.problem import Problem

#: Newton iterations after which the condensed problem takes over. A step takes 3 to 12.
_MAX_IT = 20
#: Largest number of solves, with decreasing tolerances, until the condensed residual converges.
_MAX_SOLVES = 6
#: Least factor from the tolerance of a solve to the tolerance of the next one.
_LEAST_CUT = 1e-3
#: The part of its tolerance that the next solve aims the condensed residual at. With a half, a
#: third solve is often needed, which starts without the Krylov space of the second one.
_TARGET = 0.25
#: After the first solve, linear solves reduce the residual to this part of the tolerance.
_LAST_SHARE = 0.5
#: Iterations for the pressures of a given displacement; one is exact if U is quadratic.
_PRESSURE_IT = 4


class CellPressures:
    """The mixed problem, with cell pressures as unknowns, and its solver. Collective.

    Each step starts with the pressures U'(J_e) of the last equilibrium and ends when the residual
    of the condensed problem has converged. If the solver fails, the condensed problem starts from
    the first guess.

    Parameters
    ----------
    problem : Problem
        The condensed problem.
    mixed : Problem
        The mixed problem, in the element `fem_snh.assembly.elements.with_cell_pressures`.
    prefix : str, optional
        Prefix of the mixed solver's options in PETSc's database.

    Attributes
    ----------
    snes : PETSc.SNES
        The solver of the mixed problem.
    reason : str
        Why the last `solve` ended: PETSc's name, with the cause of a failure.
    history : list of Iteration
        The iterations of the last `solve`.
    """

    def __init__(self, problem: Problem, mixed: Problem, prefix: str = solver.PREFIX) -> None:
        self._problem, self._mixed = problem, mixed
        # The condensed problem's solver examines the equilibrium.
        self.snes = solver.create(mixed, prefix=prefix, examine_stability=False)
        self.snes.setTolerances(max_it=_MAX_IT)
        self._predictor = solver.Predictor(mixed, self.snes, "tangent")
        self._residual = problem.x.duplicate()
        self._size = problem.owned_displacements
        self.reason = ""
        self.history: list[solver.Iteration] = []

    def begin_step(self) -> None:
        """Set the mixed unknowns to the equilibrium ``problem.x`` and its pressures. Collective."""
        mixed = self._mixed
        mixed.set_load(self._problem.load)
        self._read_displacement()
        saddle_point, residual = mixed.saddle_point, mixed.x.duplicate()
        assert saddle_point is not None
        saddle_point.begin_step()
        pressures = saddle_point.pressure_dofs(mixed.x)
        pressures[:] = 0.0
        # At the start of a scene the displacement need not be an equilibrium: |p| <= E.
        limit = mixed.modulus / saddle_point.unit
        for _ in range(_PRESSURE_IT):
            mixed.gradient(mixed.x, residual)
            pressures += saddle_point.pressure_correction(residual)
            pressures[:] = np.clip(np.nan_to_num(pressures), -limit, limit)

    def tangent(self) -> int:
        """Move ``problem.x`` by the linearised response to its load; return linear iterations.

        Collective.
        """
        self._mixed.set_load(self._problem.load)
        self._read_displacement()
        linear = self._predictor.tangent()
        self._write_displacement()
        return linear

    def solve(self) -> bool:
        """Solve from ``problem.x``, in place; return whether a solve converged. Collective.

        If none did, ``problem.x`` is unchanged.
        """
        problem, mixed, context = self._problem, self._mixed, self.snes.getPythonContext()
        assembling, nonfinite = mixed.seconds["assemble"], mixed.nonfinite
        mixed.set_load(problem.load)
        self._read_displacement()
        guess, self.history, solved = problem.x.copy(), [], False
        largest, unit = context.scaled_tolerance, context.force_scale
        options = dict(context.options)
        for _ in range(_MAX_SOLVES):
            with solver.callback_errors():
                self.snes.solve(None, mixed.x)
            self.history += context.history
            if self.snes.getConvergedReason() <= 0:
                break
            solved = True
            self._write_displacement()
            problem.residual(problem.x, self._residual)
            force = problem.largest_force(problem.x)
            tolerance = min(largest, context.force_tolerance(force))
            tolerance = max(tolerance, mixed.rounding_force(mixed.x))
            if (norm := self._residual.norm()) <= tolerance:
                break
            cut = max(_LEAST_CUT, _TARGET * tolerance / norm)
            context.force_scale *= cut * context.tolerance / context.scaled_tolerance
            # Near the solution one linear solve reaches the next tolerance.
            if (mixed_norm := self.snes.getFunctionNorm()) > 0:
                reduction = _LAST_SHARE * context.scaled_tolerance / mixed_norm
                context.options["snes_forcing_max"] = min(options["snes_forcing_max"], reduction)
        self.reason = solver.failure_reason(self.snes)
        context.force_scale, context.options = unit, options
        if not solved:
            guess.copy(problem.x)
        problem.seconds["assemble"] += mixed.seconds["assemble"] - assembling
        problem.nonfinite += mixed.nonfinite - nonfinite
        return solved

    def row(self) -> dict[str, object]:
        """Return the row's entries on the last solve: Newton iterations and reason."""
        return {"mixed_newton": len(self.history), "mixed_reason": self.reason}

    def _read_displacement(self) -> None:
        self._mixed.x.array[: self._size] = self._problem.x.array_r

    def _write_displacement(self) -> None:
        x: PETSc.Vec = self._problem.x
        x.array[:] = self._mixed.x.array_r[: self._size]

    def destroy(self) -> None:
        """Destroy the solver. Collective."""
        solver.destroy(self.snes)


#: Poisson's ratio from which the mixed problem is faster
#: (docs/results/elements_cell_pressures.md).
_MIXED_NU = 0.499
#: PETSc options that choose the solver of the condensed problem.
_SOLVER_OPTIONS = ("ksp_type", "pc_type", "snes_hessian", "snes_globalization", "snes_lbfgs_max_it")


class Condensation(NamedTuple):
    """The choice between eliminated and unknown cell pressures.

    Attributes
    ----------
    pressures : CellPressures or None
        The mixed problem; None if the pressures are eliminated.
    reason : str
        Why the program chose so; empty if the user chose, or without cell pressures.
    """

    pressures: CellPressures | None = None
    reason: str = ""


def choose_condensation(
    wanted: bool | None,
    problem: Problem,
    make_mixed: Callable[[], Problem],
    condensation_reason: str,
    prefix: str = solver.PREFIX,
) -> Condensation:
    """Choose whether cell pressures are eliminated. Collective.

    Parameters
    ----------
    wanted : bool or None
        Whether the user wants the pressures eliminated; None if the user did not choose.
    problem : Problem
        The condensed problem.
    make_mixed : callable
        ``make_mixed()`` returns the same problem with unknown pressures.
    condensation_reason : str
        Why the program must eliminate the pressures at any Poisson's ratio; empty if it need not.
    prefix : str, optional
        Prefix of the solver's options in PETSc's database.

    Raises
    ------
    BadInput
        On every rank, if the user wants unknown pressures but the pressure of a material's volume
        term cannot be inverted.
    """
    if wanted is not None:
        return Condensation(None if wanted else CellPressures(problem, make_mixed(), prefix))
    if problem.element.volume != "mean" or not problem.regions:
        return Condensation()
    nu = max(region.material.numbers.nu for region in problem.regions)
    if nu < _MIXED_NU:
        return Condensation(reason=f"nu = {nu:g} < {_MIXED_NU}: the condensed problem is cheaper")
    if condensation_reason:
        return Condensation(reason=condensation_reason)
    try:
        pressures = CellPressures(problem, make_mixed(), prefix)
    except BadInput as error:
        return Condensation(reason=str(error))
    return Condensation(pressures, f"nu = {nu:g} >= {_MIXED_NU}: few iterations on every mesh")


def program_pressures(
    wanted: bool | None, problem: Problem, choices: Mapping[str, object], prefix: str
) -> CellPressures | None:
    """Return the mixed problem of a dolfinx program, None if it is not chosen. Collective.

    Parameters
    ----------
    wanted, problem, prefix
        As for `choose_condensation`.
    choices : mapping
        As for `chosen_for_condensed`.

    Raises
    ------
    BadInput
        On every rank, if the user's choice is impossible for the element or a term.
    """
    if wanted is False and problem.element.volume != "mean":
        accepted = f"None: {problem.element.name} has no cell pressures"
        raise bad_value("static_condensation", wanted, accepted)
    condensation_reason = chosen_for_condensed(prefix, choices)
    stateful = [t.name for t in problem.terms[1:] if not t.stateless]
    if stateful:
        condensation_reason = f"the term '{stateful[0]}' has a state of its own"
        if wanted is False:
            raise bad_value("static_condensation", wanted, f"None, as {condensation_reason}")

    def make_mixed() -> Problem:
        """Return a problem with a displacement of its own, and the same conditions and terms."""
        element, u = with_cell_pressures(problem.element), _dolfinx.function(problem.V, "mixed")
        given = element, problem.regions, problem.dirichlet, problem.terms[1:]
        return Problem(create_unknowns(u, element), *given)

    return choose_condensation(wanted, problem, make_mixed, condensation_reason, prefix).pressures


def chosen_for_condensed(prefix: str, choices: Mapping[str, object]) -> str:
    """Return a sentence on a user's choice that concerns the condensed problem's solver, or "".

    Parameters
    ----------
    prefix : str
        The prefix of the solver's options.
    choices : mapping
        Values of ``hessian`` and ``globalization``; None if the user did not choose.
    """
    database = PETSc.Options(prefix)
    named = [name for name in _SOLVER_OPTIONS if database.hasName(name)]
    named += [key for key, value in choices.items() if value is not None]
    return f"{named[0]} was chosen, for the condensed problem" if named else ""
