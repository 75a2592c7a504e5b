"""Load steps that are approached through more compressible materials.

What makes a step from far away hard is the volume term: at nu close to 1/2 it dwarfs the rest, and
inverted cells have no way back that is not uphill in it. So a step may first find the equilibrium
of the same material with a smaller Poisson's ratio, and go on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fem_snh import solver
from fem_snh.fem.problem import Problem


class Softening:
    """The same problem with other Poisson's ratios, solved one after the other. Collective.

    ``make(nu)`` is the problem with another ratio. Each has a matrix of its own.
    """

    def __init__(self, nus: Sequence[float], make: Callable[[float], Problem], hessian: str):
        self._stages = []
        for nu in nus:
            soft = make(nu)
            self._stages.append((soft, solver.create(soft, hessian)))
        self.jit = sum(soft.seconds["jit"] for soft, _ in self._stages)

    def approach(self, problem: Problem) -> list[solver.Iteration]:
        """Move ``problem.x`` to the last one's equilibrium; the Newton iterations of them all.

        One that does not converge is left where it is: it is a guess, and the step goes on from it.
        """
        history: list[solver.Iteration] = []
        for soft, snes in self._stages:
            soft.set_load(problem.load)
            problem.x.copy(soft.x)
            assembling, nonfinite = soft.seconds["assemble"], soft.nonfinite
            with solver.own_errors():
                snes.solve(None, soft.x)
            soft.x.copy(problem.x)
            history += snes.getPythonContext().history
            problem.seconds["assemble"] += soft.seconds["assemble"] - assembling
            problem.nonfinite += soft.nonfinite - nonfinite
        return history
