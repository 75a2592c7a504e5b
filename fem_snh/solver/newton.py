"""Projected Newton as a PETSc SNES: iteration, convergence tests, history.

`ProjectedNewton` is the context of a SNES of type "python". It calls the SNES's own function,
Jacobian, objective and KSP, so monitors, converged reasons, ``-snes_view``, convergence tests and
options work as for PETSc's own types.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import expect_singular_matrix
from fem_snh.choices import ACTING_FORCES
from fem_snh.linalg.direct_solver import is_direct, set_asymmetric_factors
from fem_snh.solver import options
from fem_snh.solver.errors import clean
from fem_snh.solver.globalization import (
    FullNewton,
    LineSearchNewton,
    NewtonProgress,
    QuasiNewton,
    TrustRegion,
)
from fem_snh.solver.linear_choice import AsymmetricSolver, LinearChoice
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.saddle_point import MeritLineSearch
from fem_snh.solver.search_direction import SearchDirection
from fem_snh.solver.stability import EquilibriumStability
from fem_snh.solver.step import ForcingTerm, Iteration, LineSearch, State, Step

#: Rounding error of the residual relative to the acting forces, above which a state is no solution.
_MOST_ROUNDING = 1e-2

Reason = PETSc.SNES.ConvergedReason


class _Left(NamedTuple):
    """The unstable equilibrium that the solve left last: its energy [J] and the step's length.

    ``first`` holds the unknowns of the first state that the solve left along negative curvature, an
    equilibrium or next to one; None if there is none.
    """

    energy: float = -inf
    length: float = 0.0
    first: PETSc.Vec | None = None


class ProjectedNewton:
    r"""The context of the SNES: Newton's method with filtered Hessians.

    `SearchDirection` describes the Hessians, `LineSearch` and `TrustRegion` the globalizations,
    `QuasiNewton` the iterations between Newton steps.

    A solve converges when

    .. math:: \|f\|_2 \le \texttt{snes\_scaled\_tol}\;
              \min\left(E\, V^{2/3},\ 10^3 \max_t \|f_t\|_2\right),

    f_t the nodal forces of one term (elastic energy, loads, contact, inertia) at the present state,
    reactions included. By default the residual is then at most 1e-4 of the largest of them, also
    where these are small, as for a local contact on a large body or the weight of a stiff one. The
    test is invariant to scale and stiffness. ``-snes_atol`` [N] or ``-snes_rtol`` replace it by
    PETSc's tests; ``-snes_stol`` adds PETSc's test of the step. After the first iteration a
    residual below its rounding error converges too.

    Parameters
    ----------
    problem : SolvableProblem
    stability : EquilibriumStability, optional
        Tells whether an equilibrium is stable; None: never examined. It is used after a solve with
        a direct solver, or where `EquilibriumStability.is_doubtful`.

    Attributes
    ----------
    force_scale : float
        The unit of the residual's norm [N]; it may change between solves.
    earlier_force : float
        The norm of the forces [N] at the start of a step in time, a lower bound of the acting
        forces; 0 in statics.
    least_load : float
        The smallest norm of a dead load [N] in a step in time, an upper bound of the acting forces;
        infinity in statics.
    reduction : float
        The fraction of the first residual at which a solve also converges, after one iteration or
        more; 0 for none.
    force_iteration : bool
        Whether the next solve makes an iteration unless its first residual is zero; as PETSc's
        ``-snes_force_iteration``.
    tolerance : float
        The norm of the residual [N] at which the last solve converged, or would have.
    history : list of Iteration
        The iterations of the last solve.
    negative : int or None
        Negative eigenvalues of the exact Hessian at the end of the last solve, more than those of a
        minimum; None where they are not counted.
    rounding : float
        The rounding error [N] that ended the last solve above its tolerance; 0 otherwise.
    full_steps : bool
        Whether solves take full steps with the exact Hessian (`FullNewton`), which also converge to
        unstable equilibria; otherwise they minimise.
    asymmetric : AsymmetricSolver or None
        The linear solver of exact Hessians that are not symmetric; None if all are symmetric.
    linear_choice : LinearChoice
        The choice of the linear solver, and its reason.
    trust_ksp : KSP or None
        The linear solver of `TrustRegion`; None with a line search.
    left : _Left
        The unstable equilibrium that the last solve left last.
    give_up : callable or None
        Called with the unknowns after a step of the adaptive Hessian that was filtered and has made
        little progress; returns why the solve ends, with DIVERGED_LOCAL_MIN, or "".
    gave_up : str
        Why the last solve ended so, or "".
    """

    #: The class of the search directions; benchmarks replace it to compare methods.
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
        self.give_up: Callable[[PETSc.Vec], str] | None = None
        self.gave_up = ""

    # --- PETSc's callbacks -----------------------------------------------------------------------

    def setFromOptions(self, snes: PETSc.SNES) -> None:
        """Read `OPTIONS` under the SNES's prefix; raise BadInput for a value that is not accepted.

        ``snes_hessian`` and ``snes_globalization`` keep their values: only `create` reads them.
        """
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
        """Print the options and the number of linear iterations, as part of ``-snes_view``."""
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
        """Assemble the problem's matrix with the filter given to `assemble`; PETSc calls this."""
        whole = not self.problem.symmetric
        self._filtered_points = self.problem.jacobian(x, self._filter, whole)

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from ``x``, in place; PETSc calls this. Collective.

        Sets the SNES's converged reason and the attributes of the last solve; ignores ``b``.
        """
        self.left, self.gave_up = _Left(), ""
        self.history, self.tolerance, self.negative = [], self.scaled_tolerance, None
        state = State(x, snes.getFunction()[0])
        trial, d, forcing = State.like(state), x.duplicate(), self._forcing()
        progress = NewtonProgress()
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
                if step.end is not None:
                    progress.update(norm, state.energy, step)
                    if isinstance(globalization, TrustRegion):
                        globalization.update(step, progress)
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
            # A filter that is always on tells nothing of the Hessian.
            doubtful = progress.is_little and self.options["snes_hessian"] == "adaptive"
            if doubtful and self.give_up and (reason := self.give_up(x)):
                self.gave_up = reason
                snes.setIterationNumber(its + 1)
                snes.setFunctionNorm(norm)
                snes.setConvergedReason(Reason.DIVERGED_LOCAL_MIN)
                return
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
        """Return a new globalization for one solve, with its search directions."""
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
        """Assemble the Hessian at ``x``; return the number of filtered points. Collective."""
        self._filter = filter
        snes.computeJacobian(x, *snes.getJacobian()[:2])
        return self._filtered_points

    def line_search(self, snes: PETSc.SNES) -> LineSearch:
        """Return a line search for one solve; a `MeritLineSearch` for a saddle-point problem."""
        kind = MeritLineSearch if self.problem.saddle_point is not None else LineSearch
        return kind(snes, self.problem)

    @property
    def scaled_tolerance(self) -> float:
        """Return ``snes_scaled_tol`` times `force_scale` [N], the largest tolerance of a solve."""
        return float(self.options["snes_scaled_tol"]) * self.force_scale

    def force_at(self, x: PETSc.Vec) -> float:
        """Return the norm of the acting forces [N] that the tolerance refers to. Collective.

        This is the larger of `earlier_force` and the largest force of a term at ``x``, but at most
        `least_load`.
        """
        return min(max(self.earlier_force, self.problem.largest_force(x)), self.least_load)

    def force_tolerance(self, force: float) -> float:
        """Return the tolerance of the residual [N] where forces of norm ``force`` [N] act."""
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

        Unless ``may_end``, the solve converges only if the residual is exactly zero. Sets the
        SNES's converged reason and `tolerance`.
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
            # At the start the Hessian is an earlier state's, which a resumed run does not have. It
            # serves with `reduction`, where a state is solved for again.
            assembled = its > 0 or self.reduction > 0
            if norm <= self.tolerance or (assembled and self._is_rounding(x, norm)):
                reason = Reason.CONVERGED_FNORM_ABS
        snes.setConvergedReason(reason)
        snes.monitor(its, norm)
        return bool(reason)

    def _tolerance(self, snes: PETSc.SNES, x: PETSc.Vec, norm: float) -> float:
        """Return the tolerance [N] for the residual at ``x``, whose norm is ``norm``. Collective.

        The acting forces cost a residual; they are evaluated only if the outcome depends on them.
        """
        rtol, atol = snes.getTolerances()[:2]
        if rtol or atol:
            return max(atol, rtol * self._first_norm)
        earlier = min(self.scaled_tolerance, self.force_tolerance(self.earlier_force))
        if earlier < norm <= self.scaled_tolerance:
            return min(self.scaled_tolerance, self.force_tolerance(self.force_at(x)))
        return earlier or self.scaled_tolerance

    def _is_rounding(self, x: PETSc.Vec, norm: float) -> bool:
        """Return whether the residual's norm [N] is within its rounding error at ``x``.

        If so, `tolerance` and `rounding` become the error's bound. A bound that is large beside the
        forces does not count: a body may have flown off to 1e14 times its size.
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
        """Return a step that leaves an unstable equilibrium; its end is None if the solve stays.

        The solve stays without a trust region. ``negative`` is the number of negative eigenvalues
        of the last Hessian, or None. Sets the attributes `negative` and `left`.
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
