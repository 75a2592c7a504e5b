r"""Solve a failed step again by full Newton steps, with a proximal term if needed.

With contact, minimisation may fail: a body that nothing but contact constrains has no stiffness
along some motion, bodies that slide off each other leave their path, and a follower pressure or
friction has no energy to minimise. Full steps of Newton's method with the exact Hessian converge to
any equilibrium nearby. A proximal term keeps the end of each solve near its start,

.. math:: \frac{r}{2 L^2} \int E\, |u - u_k|^2 \, \mathrm{d}V ,

with the displacement :math:`u_k` of the solve before. This is pseudo-transient continuation (Kelley
& Keyes 1998): the rate r increases when a solve fails and decreases when it converges. The step
ends when the forces of the proximal term are within the tolerance of the residual, so that the
state is an equilibrium without the term.
"""

from __future__ import annotations

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.unknowns import local_values
from fem_snh.errors import NotSettled
from fem_snh.problem.free_motions import Supports
from fem_snh.problem.problem import Problem
from fem_snh.solver.step import update_lagged
from fem_snh.steps.dynamics.integrators import Affine
from fem_snh.steps.dynamics.motion_terms import Inertia
from fem_snh.terms.history import MAX_SOLVES

#: The first rate r of a body that is free to move: the term is about as stiff as the body.
_FIRST = 1.0
#: Factors of the rate after a solve that converged, the same once a solve of the step has failed,
#: and after a failure; the least rate; the number of successive failures allowed. An O-ring that
#: slides to the side of its groove needs rates up to 1e3, at the onset of friction 1e6, and 3 to 40
#: solves.
_DECREASE, _SLOW_DECREASE, _INCREASE, _LEAST, _MOST_FAILURES = 0.1, 0.3, 10.0, 1e-2, 9


class Rescue:
    """Solves a step by pseudo-transient continuation, after minimisation failed. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    snes : PETSc.SNES
        The problem's solver.
    """

    def __init__(self, problem: Problem, snes: PETSc.SNES) -> None:
        self._problem, self._snes = problem, snes
        regions = [r._replace(density=r.material.numbers.E) for r in problem.regions]
        self._term = Inertia(NodalMass(problem.V, regions, "lumped", problem.kinematics))
        #: The rate of a step's first solve; 0, no proximal term, unless the body is free to move.
        self._first = _FIRST if Supports(problem).left.shape[1] else 0.0

    def solve(self, outcome: solver.StepOutcome) -> None:
        """Solve from ``problem.x``, in place, until `_update` is satisfied or solves fail.

        Parameters
        ----------
        outcome : StepOutcome
            The outcome of the step, to which each solve is added.
        """
        problem, context = self._problem, self._snes.getPythonContext()
        rate, failures, again, accepted = self._first, 0, True, problem.x.copy()
        factor = _DECREASE
        context.full_steps = True
        problem.terms.append(self._term)
        try:
            while again:
                origin = local_values(problem.split(accepted)[0]).copy()
                pulls = Affine(rate / problem.length**2, origin)
                self._term.acceleration = pulls if rate else None
                with solver.callback_errors():
                    self._snes.solve(None, problem.x)
                outcome.add_solve(self._snes)
                if outcome.converged:
                    again = self._update(outcome)
                    problem.x.copy(accepted)
                    failures, rate = 0, max(_LEAST, factor * rate) if rate else 0.0
                else:
                    failures, factor = failures + 1, _SLOW_DECREASE
                    again = failures <= _MOST_FAILURES and not outcome.out_of_memory
                    rate = max(_FIRST, _INCREASE * rate)
                    accepted.copy(problem.x)
        finally:
            context.full_steps = False
            problem.terms.remove(self._term)
        if not outcome.converged:
            return
        if rate:
            self._first = _FIRST
        if context.stability is not None:
            outcome.negative = context.stability.negative_eigenvalues(problem.x)

    def _update(self, outcome: solver.StepOutcome) -> bool:
        """Update lagged quantities after a solve; return whether to solve again. Collective.

        Solve again, too, while the proximal term's force exceeds the tolerance.
        """
        problem, forces = self._problem, self._problem.x.duplicate()
        again = update_lagged(problem, outcome)
        problem.gradient(problem.x, forces, [self._term])
        problem.project(forces.array)
        force, tolerance = forces.norm(), outcome.tolerance or 0.0
        largest = problem.largest_force(problem.x)
        if self._term.acceleration is not None:
            outcome.stabilisation = force / largest if largest > 0 else 0.0
        if not outcome.converged or force <= tolerance:
            return again
        if problem.history.solves >= MAX_SOLVES:
            what = f"the force of stabilisation is {force / tolerance:.3g} times the tolerance"
            outcome.fail_inner(NotSettled(f"{what} after {MAX_SOLVES} solves"))
        return outcome.converged
