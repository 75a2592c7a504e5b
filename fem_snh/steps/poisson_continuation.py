"""Continuation in Poisson's ratio: solve a load step first with more compressible materials.

At nu close to 1/2 the volume term dominates the energy, and an inverted cell can unfold only by
increasing this term. A smaller Poisson's ratio has no such barrier, and its equilibrium is a good
initial guess for the next ratio. Materials that are more compressible keep their own ratio.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fem_snh import solver
from fem_snh.problem.problem import Problem


class PoissonContinuation:
    """Auxiliary problems with other Poisson's ratios, each with a matrix and a solver of its own.

    Parameters
    ----------
    nus : sequence of float
        Poisson's ratios, in the order in which they are solved.
    make_problem : callable
        ``make_problem(nu)`` returns the problem with this Poisson's ratio. Collective.
    hessian, globalization : str or None
        As for `fem_snh.solver.create`.
    """

    def __init__(
        self,
        nus: Sequence[float],
        make_problem: Callable[[float], Problem],
        hessian: str | None,
        globalization: str | None,
    ) -> None:
        self._stages = []
        for nu in nus:
            stage = make_problem(nu)
            self._stages.append((stage, solver.create(stage, hessian, globalization)))

    def solve(self, problem: Problem) -> list[solver.Iteration]:
        """Solve from ``problem.x`` for one ratio after the other, in place. Collective.

        If the solve of a ratio does not converge, its last iterate is the next initial guess.

        Returns
        -------
        list of Iteration
            The Newton iterations of all ratios.
        """
        history: list[solver.Iteration] = []
        for stage, snes in self._stages:
            stage.set_load(problem.load)
            problem.x.copy(stage.x)
            assembling, nonfinite = stage.seconds["assemble"], stage.nonfinite
            with solver.callback_errors():
                snes.solve(None, stage.x)
            stage.x.copy(problem.x)
            history += snes.getPythonContext().history
            problem.seconds["assemble"] += stage.seconds["assemble"] - assembling
            problem.nonfinite += stage.nonfinite - nonfinite
        return history

    def destroy(self) -> None:
        """Destroy the solvers. Collective."""
        for _, snes in self._stages:
            solver.destroy(snes)
