"""Goals of rigid parts: their motions, and the forces and moments that hold them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fem_snh.accuracy.duals import Dual, Linearisation, dual_of_reaction
from fem_snh.accuracy.goals import VectorGoal
from fem_snh.accuracy.rest import largest_displacement
from fem_snh.problem.problem import Problem


class RigidGoal(VectorGoal):
    """Components of a motion of a rigid part, or of what holds it against the flesh.

    Parameters
    ----------
    part, kind : str
        The part's name, and "displacement" [m] of its point, "rotation" [rad], the rotation vector,
        "force" [N] or "moment" [N m] about the point.
    components : sequence of int, optional
        The components; default: all.
    label : str, optional
        What it is called; default: PART.KIND.
    """

    def __init__(
        self, part: str, kind: str, components: Sequence[int] = (0, 1, 2), label: str = ""
    ) -> None:
        super().__init__(label or f"{part}.{kind}", components)
        self._part, self._kind, self.is_force = part, kind, kind == "force"

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""

        def values() -> list[float]:
            return self.components_of(problem.rigid_states(problem.x)[self._part][self._kind])

        return values

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`. That of a rotation is the displacement over the body's size."""
        if self._kind == "displacement":
            return largest_displacement(problem)
        if self._kind == "rotation":
            return largest_displacement(problem) / problem.length
        arm = problem.length if self._kind == "moment" else 1.0
        return arm * problem.largest_force(problem.x)

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        problem, rigid, x = at.problem, at.problem.rigid, at.problem.x
        assert rigid is not None
        number = self._components[number]
        if self._kind in ("displacement", "rotation"):
            return at.dual_of_all(rigid.derivative_of_pose(x, self._part, self._kind, number))
        turned = self._kind == "moment"
        e, turning = rigid.velocity(x, self._part, np.eye(6)[number + 3 * turned]), None
        if turned:  # the arms turn with the part
            forces = x.duplicate()
            problem.gradient(x, forces)
            turning = rigid.derivative_of_arms(x, self._part, forces, number)
        return dual_of_reaction(at, e, turning)
