"""Projected Newton as a PETSc SNES: iteration, convergence tests, history.

`ProjectedNewton` is the context of a SNES of type "python". It uses only what the SNES was given
(function, Jacobian, objective, KSP), so monitors, converged reasons, ``-snes_view``, convergence
tests and options work as for PETSc's own types.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import expect_singular_matrix
from fem_snh.choices import ACTING_FORCES
from fem_snh.linalg.direct_solver import is_direct, set_asymmetric_factors
from fem_snh.solver import options
from fem_snh.solver.errors import clean
from fem_snh.solver.globalization import FullNewton, LineSearchNewton, QuasiNewton, TrustRegion
from fem_snh.solver.linear_choice import AsymmetricSolver, LinearChoice
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.saddle_point import MeritLineSearch
from fem_snh.solver.search_direction import SearchDirection
from fem_snh.solver.stability import EquilibriumStability
from fem_snh.solver.step import ForcingTerm, Iteration, LineSearch, State, Step

#: Rounding error of the residual over the forces that act, above which a state is no solution.
_MOST_ROUNDING = 1e-2

Reason = PETSc.SNES.ConvergedReason


class _Left(NamedTuple):
    """The unstable equilibrium that was left last: its energy [J], and the length of the step.

    ``first`` is the state that the solve has left first, about an equilibrium.
    """

    energy: float = -inf
    length: float = 0.0
    first: PETSc.Vec | None = None


class ProjectedNewton:
    r"""Newton's method on an energy, with filtered Hessians.

    `SearchDirection` describes the Hessians, `LineSearch` and `TrustRegion` the globalizations,
    `QuasiNewton` the iterations between Newton steps.

    Converged when

    .. math:: \|f\|_2 \le \texttt{snes\_scaled\_tol}\;
              \min\left(E\, V^{2/3},\ 10^3 \max_t \|f_t\|_2\right),

    f_t the forces of one term at the present state, reactions included: of the elastic energy, of
    loads, of contact, of inertia. Where they are small, as those of a local contact on a large body
    or the weight of a stiff one, the residual is so too: 1e-4 of them by default. The test is
    invariant to scale and stiffness. ``-snes_atol`` [N] and ``-snes_rtol`` replace it by PETSc's
    tests; ``-snes_stol`` adds one. After an iteration the residual need not come below its rounding
    error, which is also the end of a solve that no step improves.

    Parameters
    ----------
    problem : SolvableProblem
    stability : EquilibriumStability, optional
        Tells whether an equilibrium is stable. It is asked where the linear solver has factors, and
        where parts are stiff.

    Attributes
    ----------
    force_scale : float
        The unit of the residual's norm [N]; it may change between solves.
    earlier_force, least_load : float
        Of a step in time, whose errors add up: the norm of the forces [N] at its start, which count
        as those that act, and the smallest one of a dead load, which may be small beside others.
    reduction : float
        The part of its first residual at which a solve ends as well: 1 makes one iteration unless
        the start is a solution.
    force_iteration : bool
        Whether the next solve makes an iteration, whatever its first residual; as PETSc's
        ``-snes_force_iteration``.
    tolerance : float
        The norm of the residual [N] at which the last solve converged, or would have.
    history : list of Iteration
        Of the last solve.
    negative : int or None
        Negative eigenvalues of the exact Hessian at the end of the last solve, more than those of a
        minimum; None where they are not counted.
    rounding : float
        The rounding error [N] that ended the last solve above its tolerance; 0 otherwise.
    full_steps : bool
        Whether a solve takes full steps with the exact Hessian, which converge to unstable
        equilibria, too (`FullNewton`); otherwise it minimises.
    asymmetric : AsymmetricSolver or None
        The linear solver of exact Hessians that are not symmetric, where they may be.
    linear_choice, trust_ksp : LinearChoice, KSP or None
        The linear solver and why it was chosen; that of `TrustRegion`, None with a line search.
    """

    #: The class of the search directions; benchmarks replace it to compare others.
    search_direction: type[SearchDirection] = SearchDirection

    def __init__(
        self, problem: SolvableProblem, stability: EquilibriumStability | None = None
    ) -> None:
        self.problem, self.force_scale = problem, problem.force_scale
        self.earlier_force, self.least_load = 0.0, inf
        self.force_iteration, self._first_norm, self.rounding = False, 0.0, 0.0
        self.reduction = 0.0
        self.options = options.defaults_for("linesearch")
        self.tolerance = self.scaled_tolerance
        self.history: list[Iteration] = []
        self.stability = stability
        self.negative: int | None = None
        self.full_steps = False
        self.full_ksp: PETSc.KSP | None = None
        self.trust_ksp: PETSc.KSP | None = None
        self.asymmetric: AsymmetricSolver | None = None
        self.linear_choice = LinearChoice(False)
        self._filter, self._filtered_points = "exact", 0
        self._dtol_given = False
        self.left = _Left()

    # --- PETSc's callbacks -----------------------------------------------------------------------

    def setFromOptions(self, snes: PETSc.SNES) -> None:
        """Read the options under the SNES's prefix; raise BadInput for a bad value."""
        prefix = snes.getOptionsPrefix()
        self._dtol_given = PETSc.Options(prefix).hasName("snes_divergence_tolerance")
        self.options = options.read(prefix, self.options)
        if self.problem.saddle_point is not None:
            options.check_minimisation(
                self.options, "Taylor-Hood elements give a saddle-point problem"
            )
        elif not self.problem.has_energy:
            options.check_minimisation(self.options, "this one has forces without an energy")

    def view(self, snes: PETSc.SNES, viewer: PETSc.Viewer) -> None:
        """Print the options, as part of ``-snes_view``."""
        if viewer.getType() == PETSc.Viewer.Type.ASCII:
            strategy = {"linesearch": "line search", "trust_region": "trust region"}
            name = strategy[str(self.options["snes_globalization"])]
            viewer.printfASCII(f"  projected Newton with a {name}\n")
            for name, value in self.options.items():
                text = f"{value:g}" if isinstance(value, float) else value
                viewer.printfASCII(f"  {name} = {text}\n")
            # PETSc's own count below stays 0: only its built-in types can add to it.
            linear = sum(iteration.linear for iteration in self.history)
            viewer.printfASCII(f"  linear iterations of the last solve = {linear}\n")

    def jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """Assemble the Jacobian with the present iteration's filter: the SNES's callback."""
        whole = not self.problem.symmetric
        self._filtered_points = self.problem.jacobian(x, self._filter, whole)

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from ``x``, in place. Collective."""
        self.left = _Left()
        self.history, self.tolerance, self.negative = [], self.scaled_tolerance, None
        state = State(x, snes.getFunction()[0])
        trial, d, forcing = State.like(state), x.duplicate(), self._forcing()
        globalization = self._globalization(snes, forcing)
        state.energy = snes.computeObjective(x) if self.problem.has_energy else 0.0
        if not isfinite(state.energy):
            snes.setIterationNumber(0)  # not those of an earlier solve
            snes.setFunctionNorm(state.energy)
            snes.setConvergedReason(Reason.DIVERGED_FUNCTION_DOMAIN)
            return
        snes.computeFunction(x, state.residual)
        norm, step_norm, step = state.residual.norm(), 0.0, Step()
        first, self._first_norm = not self.force_iteration, norm
        self.force_iteration, self.rounding = False, 0.0
        max_it = snes.getTolerances()[3]
        for its in range(max_it + 1):
            if self._test_convergence(snes, its, x, step_norm, norm, first or its > 0):
                step = self._leave_unstable(snes, state, step.negative, trial)
                if step.end is None:
                    return
                if isinstance(globalization, TrustRegion):
                    globalization.leave_equilibrium(state.energy - step.end.energy)
            elif its == max_it:
                break
            else:
                if user_update := snes.getUpdate():
                    function, arguments, keywords = user_update
                    function(snes, its, *arguments, **keywords)
                forcing.update(norm)
                step = globalization.step(state, d, trial)
            self.history.append(
                Iteration(
                    norm, state.energy, step.filter, step.filtered_points,
                    step.linear, step.length, step.lbfgs,
                )
            )  # fmt: skip
            if step.end is None:
                if self._is_rounding(x, norm):
                    step.diverged = Reason.CONVERGED_FNORM_ABS
                snes.setConvergedReason(step.diverged)
                return
            # In the region the solve leaves an unstable state, next to an equilibrium.
            if step.filter == "trust_region" and not self.left.first:
                self.left = self.left._replace(first=x.copy())
            if step.lbfgs:
                d.waxpy(-1.0, x, step.end.x)
            step.end.copy_to(state)
            step_norm = d.norm() * (1.0 if step.lbfgs else step.length)
            norm = state.residual.norm()
            # petsc4py frees dropped objects only when told to, for each communicator.
            clean([x.comm, snes.getJacobian()[1].comm])
        snes.setConvergedReason(Reason.DIVERGED_MAX_IT)

    # --- the parts of an iteration ---------------------------------------------------------------

    def _forcing(self) -> ForcingTerm:
        """Return the forcing terms of one solve."""
        largest, safeguard = (
            float(self.options[f"snes_forcing_{key}"]) for key in ("max", "safeguard")
        )
        return ForcingTerm(largest, safeguard * self.scaled_tolerance)

    def _globalization(
        self, snes: PETSc.SNES, forcing: ForcingTerm
    ) -> LineSearchNewton | FullNewton | TrustRegion:
        """Return the globalization of one solve, with its parts."""
        direction = self.search_direction(self, snes, forcing)
        if self.full_steps:
            if self.full_ksp is None:
                self.full_ksp = PETSc.KSP().create(snes.comm)
                set_asymmetric_factors(self.full_ksp)
                expect_singular_matrix(self.full_ksp)
            return FullNewton(direction, self.full_ksp)
        ksp = self.trust_ksp
        max_it, atol = float(self.options["snes_lbfgs_max_it"]), self.scaled_tolerance
        quasi_newton = QuasiNewton(ksp or snes.getKSP(), direction.line_search, max_it, atol)
        if ksp is None:
            return LineSearchNewton(direction, quasi_newton)
        return TrustRegion(direction, ksp, quasi_newton)

    def assemble(self, snes: PETSc.SNES, x: PETSc.Vec, filter: str) -> int:
        """Assemble the SNES's matrices; return the quadrature points filtered. Collective."""
        self._filter = filter
        snes.computeJacobian(x, *snes.getJacobian()[:2])
        return self._filtered_points

    def line_search(self, snes: PETSc.SNES) -> LineSearch:
        """Return the line search of one solve: on the energy, or on a saddle point's merit."""
        kind = MeritLineSearch if self.problem.saddle_point is not None else LineSearch
        return kind(snes, self.problem)

    @property
    def scaled_tolerance(self) -> float:
        """Return the largest norm of the residual [N] at which a solve may converge."""
        return float(self.options["snes_scaled_tol"]) * self.force_scale

    def force_at(self, x: PETSc.Vec) -> float:
        """Return the norm of the forces [N] beside which a residual is small. Collective.

        The forces that act at ``x`` or at the step's start, or a dead load smaller than these.
        """
        return min(max(self.earlier_force, self.problem.largest_force(x)), self.least_load)

    def force_tolerance(self, force: float) -> float:
        """Return the norm of the residual [N] that is small where forces of this norm [N] act."""
        return ACTING_FORCES * float(self.options["snes_scaled_tol"]) * min(force, self.least_load)

    def _test_convergence(
        self,
        snes: PETSc.SNES,
        its: int,
        x: PETSc.Vec,
        step_norm: float,
        norm: float,
        may_end: bool,
    ) -> bool:
        """Report the iteration to the SNES; return whether PETSc's or the scaled test stops it.

        Convergence counts only where it ``may_end``, or without any residual.
        """
        snes.setIterationNumber(its)
        snes.setFunctionNorm(norm)
        snes.logConvergenceHistory(norm)
        reason = snes.callConvergenceTest(its, x.norm(), step_norm, norm)
        if reason == Reason.DIVERGED_DTOL and not self._dtol_given:
            reason = 0  # near an unstable state the residual grows while the energy decreases
        if reason > 0 and not may_end:
            reason = 0
        if (may_end or norm == 0) and not reason > 0:
            self.tolerance = self._tolerance(snes, x, norm)
            if its:
                self.tolerance = max(self.tolerance, self.reduction * self._first_norm)
            # At the start the Hessian is that of an earlier state, so that a run that is resumed
            # would not be the same; but it serves where a state is solved for again.
            assembled = its > 0 or self.reduction > 0
            if norm <= self.tolerance or (assembled and self._is_rounding(x, norm)):
                reason = Reason.CONVERGED_FNORM_ABS
        snes.setConvergedReason(reason)
        snes.monitor(its, norm)
        return bool(reason)

    def _tolerance(self, snes: PETSc.SNES, x: PETSc.Vec, norm: float) -> float:
        """Return the norm [N] at which a state with this residual would be a solution. Collective.

        The forces that act are evaluated only where it depends on them, at the cost of a residual.
        """
        rtol, atol = snes.getTolerances()[:2]
        if rtol or atol:
            return max(atol, rtol * self._first_norm)
        earlier = min(self.scaled_tolerance, self.force_tolerance(self.earlier_force))
        if earlier < norm <= self.scaled_tolerance:
            return min(self.scaled_tolerance, self.force_tolerance(self.force_at(x)))
        return earlier or self.scaled_tolerance

    def _is_rounding(self, x: PETSc.Vec, norm: float) -> bool:
        """Return whether a residual is a rounding error, whose bound is then the tolerance.

        That of a state that is nothing but rounding is not: of a body that has flown off to 1e14
        times its size.
        """
        bound = self.problem.rounding_force(x, norm)
        if not norm <= bound:
            return False
        if bound > self.scaled_tolerance:
            if bound > _MOST_ROUNDING * self.problem.largest_force(x):
                return False
        self.tolerance = self.rounding = bound
        return True

    def _leave_unstable(
        self, snes: PETSc.SNES, state: State, negative: int | None, trial: State
    ) -> Step:
        """Return the step that leaves an unstable equilibrium, without an end if there is none.

        ``negative`` is the number of negative eigenvalues of the last Hessian, if it is known.
        """
        found, converged = self.stability, snes.getConvergedReason() > 0
        if found is None or self.full_steps or not converged:
            return Step()
        if not (is_direct(snes.getKSP()) or found.is_doubtful):
            return Step()
        if negative == found.expected:
            self.negative = 0
        elif self.trust_ksp is None:
            self.negative = found.negative_eigenvalues(state.x)
        else:
            # A valley of equilibria within the tolerance is followed by longer and longer steps.
            left = self.left
            shortest = 2 * left.length if state.energy < left.energy else 0.0
            search = self.line_search(snes)
            self.negative, length = found.leave(state, search, trial, shortest)
            if length > 0:
                self.left = _Left(state.energy, length, left.first or state.x.copy())
                return Step(trial, length, filter="negative curvature")
        return Step()
