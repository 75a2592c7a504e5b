"""Steps of the linearised problem: first guesses of Newton's method, and semi-implicit Euler.

`fem_snh.steps.stepping` calls `Predictor.predict` before each solve, or for semi-implicit Euler
`solve_linearised` instead of a solve.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

from petsc4py import PETSc

from fem_snh._petsc import factors_out_of_memory, set_operators
from fem_snh.choices import DEFAULT_PREDICTOR, PREDICTORS
from fem_snh.errors import NotSettled, bad_value, choose
from fem_snh.solver.errors import callback_errors, clean
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.saddle_point import outer_operator
from fem_snh.solver.step import (
    ForcingTerm,
    Iteration,
    State,
    StepOutcome,
    linear_failure,
    relative_tolerance,
    update_lagged,
)

#: Largest displacement of the central difference along the boundary's motion, relative to V^(1/3):
#: about the cube root of the rounding error, where truncation and rounding are balanced.
_DIFFERENCE = 1e-6


def linearised_residual(problem: SolvableProblem) -> PETSc.Vec:
    """Return r + H_fc j at ``problem.x``, whose boundary values are those of another load.

    r is the residual at the present load, j the change of the boundary values to the present load,
    H_fc the block of free rows and constrained columns. The assembled matrix has no constrained
    columns, so H_fc j is a central difference of residuals along j. Collective.
    """
    x = problem.x
    jump = x.copy()
    problem.prescribe(jump)
    jump.axpy(-1.0, x)
    size = jump.norm(PETSc.NormType.INFINITY)
    rhs, other, moved = (x.duplicate() for _ in range(3))
    problem.residual(x, rhs)
    if size > 0:
        h = _DIFFERENCE * problem.length / size
        for sign in (1, -1):
            moved.waxpy(sign * h, jump, x)
            problem.residual(moved, other)
            rhs.axpy(sign / (2 * h), other)
    return rhs


def take_step(problem: SolvableProblem, factor: float, step: PETSc.Vec) -> None:
    """Add ``factor`` times ``step`` to ``problem.x``, along paths that steps must follow."""
    paths, x = problem.retraction, problem.x
    if paths and paths.exact:
        paths(x.copy(), step, factor, x)
    else:
        x.axpy(factor, step)


def solve_linearised(problem: SolvableProblem, snes: PETSc.SNES) -> StepOutcome:
    """Make a linearised step of backward Euler from ``problem.x``; return its outcome. Collective.

    This is the step of semi-implicit Euler (Baraff & Witkin 1998): the Hessian and the linear
    solver of the SNES, without forcing terms and without a line search. The residual of the linear
    system, computed in double precision, must not exceed ``-ksp_rtol`` times the norm of the
    right-hand side, nor times the norm of the acting forces: a stiff body may begin with elastic
    forces far above its loads. A residual within rounding errors suffices. An inaccurate solution
    is refined; if that fails, sparse factors replace a linear solver that the user did not choose.
    Otherwise the step fails.

    Parameters
    ----------
    problem : SolvableProblem
    snes : SNES
        The problem's solver, of `create`. Its converged reason and history are set as by a solve.
    """
    outcome = _linearised_step(problem, snes)
    if outcome.converged:  # lagged quantities follow once a step
        update_lagged(problem, outcome)
    snes.getPythonContext().history = outcome.history
    name = outcome.reason.partition(":")[0]
    snes.setConvergedReason(getattr(PETSc.SNES.ConvergedReason, name))
    # petsc4py frees dropped objects only when told to, for each communicator.
    clean([problem.x.comm])
    return outcome


def _linearised_step(problem: SolvableProblem, snes: PETSc.SNES) -> StepOutcome:
    """Solve the linear system, move ``problem.x`` by the solution and return the outcome."""
    x = problem.x
    start, d = State(x, linearised_residual(problem)), x.duplicate()
    # A new one for each step: a run that is resumed has no memory of the last one's Hessian.
    context = snes.getPythonContext()
    forcing = ForcingTerm(0.0, snes.getKSP().getTolerances()[0] * context.force_at(x))
    found = context.search_direction(context, snes, forcing, True).compute(start, d)
    norm = start.residual.norm()
    iteration = Iteration(norm, 0.0, found.filter, found.filtered_points, found.linear, 1.0)
    outcome = StepOutcome(False, "CONVERGED_ITS", norm, [iteration])
    outcome.linear_residual = found.residual
    if norm > 0 and (found.slope is None or found.inaccuracy):
        linear = snes.getKSP()
        outcome.reason = linear_failure(linear, found)
        outcome.out_of_memory = found.out_of_memory or factors_out_of_memory(linear.getPC())
        return outcome
    if norm > 0:
        take_step(problem, 1.0, d)
    problem.prescribe(x)
    if problem.has_energy and not isfinite(problem.energy(x)):
        outcome.reason = "DIVERGED_FUNCTION_DOMAIN"
        return outcome
    problem.residual(x, start.residual)
    outcome.residual = start.residual.norm()
    outcome.converged = isfinite(outcome.residual)
    if not outcome.converged:
        outcome.reason = "DIVERGED_FNORM_NAN"
    elif found.replacement:
        outcome.reason += f": {found.replacement}"
    return outcome


_MAX_IT = PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
#: Smallest relative tolerance of the tangent's linear solve: the linear model is no more accurate.
#: The residual of a saddle-point problem is measured without a preconditioner, so cells at moved
#: boundaries dominate its norm, and a hundredth of it leaves errors whose strains grow with
#: refinement (docs/results/elements_taylor_hood.md).
_RTOL, _SADDLE_RTOL = 1e-2, 1e-3
#: Fraction of the largest admissible step that a prediction takes: at that step surfaces touch.
_SHARE = 0.5


class Predictor:
    """Predictor that moves ``problem.x`` from the equilibrium at one load to a guess at the next.

    ===============  ==============================================================================
    ``none``         the new boundary values; the free unknowns are unchanged
    ``extrapolate``  the last step's displacement, continued in proportion to the load; the tangent
                     at the first step
    ``tangent``      the linearised response to the change of load: one linear solve
    ``bones``        the last equilibrium, moved with the bones in it
    ===============  ==============================================================================

    Where the problem does not admit the whole change, as with a barrier, all unknowns take half of
    the admissible step; then only the constrained unknowns change to their new values.

    Parameters
    ----------
    problem : SolvableProblem
    snes : SNES
        The SNES whose linear solver is used.
    kind : str
        One of `fem_snh.choices.PREDICTORS`.
    extrapolation : callable, optional
        ``extrapolation(x, load)`` moves the equilibrium x in place to its extrapolation at a load,
        for problems in time by the velocity. It replaces the extrapolation from the last step.
    response : callable, optional
        Replaces `tangent`: moves ``problem.x`` by the linearised response and returns the linear
        iterations.
    blend : callable, optional
        ``blend(x, start, end)`` moves the equilibrium x in place with the bones from the load
        ``start`` to the load ``end``; ``bones`` requires it.

    Attributes
    ----------
    before : (float, Vec) or None
        Load and unknowns of the equilibrium before the present one, for ``extrapolate``; None at
        the first step. Nothing else is kept between steps.
    """

    def __init__(
        self,
        problem: SolvableProblem,
        snes: PETSc.SNES,
        kind: str = DEFAULT_PREDICTOR,
        extrapolation: Callable[[PETSc.Vec, float], None] | None = None,
        blend: Callable[[PETSc.Vec, float, float], None] | None = None,
        response: Callable[[], int] | None = None,
    ) -> None:
        self.problem, self.snes, self._extrapolation = problem, snes, extrapolation
        self.kind, self._blend = choose("predictor", kind, PREDICTORS), blend
        if kind == "bones" and blend is None:
            raise bad_value("predictor", kind, "another one, as there are no bones")
        self._response = response  # a bound method of this object would be a reference cycle
        self.before: tuple[float, PETSc.Vec] | None = None

    def predict(self, load: float, stay: bool = False) -> int:
        """Set the load and move ``problem.x`` to the guess; return linear iterations. Collective.

        With ``stay`` the guess is the present state with the boundary values at the load.

        Raises
        ------
        NotSettled
            On every rank, if the problem does not admit the motion of the constrained unknowns.
        """
        problem, x, old = self.problem, self.problem.x, self.problem.load
        present, linear = x.copy(), 0
        problem.set_load(load)
        if stay:
            pass
        elif self.kind == "extrapolate" and self._extrapolation is not None:
            self._extrapolation(x, load)
        elif self.kind == "bones" and self._blend is not None:
            self._blend(x, old, load)
        elif self.kind == "extrapolate" and self.before is not None:
            earlier, before = self.before
            x.axpy((load - old) / (old - earlier), present)
            x.axpy(-(load - old) / (old - earlier), before)
        elif self.kind != "none":
            linear = (self._response or self.tangent)()
        problem.prescribe(x)
        if problem.retraction:
            problem.retraction.move_rigidly(present, x)
        linear += self._admit(present)
        self._last = (old, present)
        return linear

    def _admit(self, present: PETSc.Vec) -> int:
        """Change a guess that is not admissible from ``present``; return linear iterations."""
        problem, x, largest_step = self.problem, self.problem.x, self.problem.largest_step
        if largest_step is None:
            return 0
        d = x - present
        step = largest_step(present, d)
        if step == 1:
            return 0
        start = present + _SHARE * step * d
        start.copy(x)
        problem.prescribe(x)
        if largest_step(start, x - start) == 1:
            return 0
        linear = 0
        if self.kind != "tangent":
            # The linear response moves the free unknowns away from the constrained ones.
            present.copy(x)
            linear = (self._response or self.tangent)()
            problem.prescribe(x)
        if self.kind == "tangent" or largest_step(present, x - present) < 1:
            raise NotSettled(
                "the prescribed motion of the step is too large: it takes a surface through the "
                "body, or farther than collision detection resolves; expected more 'steps', or a "
                "smaller 'move' or 'bone'"
            )
        return linear

    def accept(self) -> None:
        """Set `before` to the last predicted step's start, unless ``extrapolation`` is given."""
        if self._extrapolation is None:
            self.before = self._last

    @callback_errors()
    def tangent(self) -> int:
        """Move ``problem.x`` by the linearised response to the load; return linear iterations.

        The Hessian is clamped, so that CG cannot fail. Constrained unknowns do not change.
        """
        problem, x = self.problem, self.problem.x
        rhs, step = linearised_residual(problem), self.problem.x.duplicate()
        problem.jacobian(x, "clamp")
        if problem.saddle_point:
            problem.saddle_point.update_schur_approximation(problem.P)
        ksp = self.snes.getKSP()
        smallest = _SADDLE_RTOL if problem.saddle_point else _RTOL
        with relative_tolerance(ksp, max(ksp.getTolerances()[0], smallest)):
            set_operators(ksp, outer_operator(ksp, problem.operator, problem.P), problem.P)
            ksp.solve(rhs, step)
        # After any other failure the guess is the old state: Newton's linear solve will report it.
        if ksp.getConvergedReason() > 0 or ksp.getConvergedReason() == _MAX_IT:
            take_step(problem, -1.0, step)
        return int(ksp.getIterationNumber())
