"""The work that moving obstacles do on a body in a step, and what their friction dissipates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.contact.friction import Friction
from fem_snh.contact.obstacle_pair import ContactPair
from fem_snh.geometry.motions import Obstacle

Array = npt.NDArray[Any]


class PointForces(NamedTuple):
    """Forces of an obstacle on a body.

    Attributes
    ----------
    x : (n, 3)
        Their points of action [m].
    forces : (n, 3)
        The forces [N].
    """

    x: Array
    forces: Array


class ObstacleWork:
    """Work and dissipation of obstacles in one step.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    pairs, frictions : sequence of ContactPair, of Friction or None
        The contact with each obstacle, and its friction.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        pairs: Sequence[ContactPair],
        frictions: Sequence[Friction | None],
    ) -> None:
        self._comm = comm
        self._both = list(zip(pairs, frictions, strict=True))
        self._load = 0.0
        self._before = list[PointForces | None]()

    def begin_step(self, u: Array) -> None:
        """Keep the forces at the start of a step; pairs and frictions have begun it."""
        self._load = self._both[0][0].load
        self._before = [
            None if pair.obstacle.motion is None else contact_forces(pair, friction, u, False)
            for pair, friction in self._both
        ]

    def measure(self, u: Array, end_weight: float) -> tuple[float, float]:
        """Return work of the obstacles and dissipation by friction [J]. Collective."""
        work = lost = 0.0
        for (pair, friction), before in zip(self._both, self._before, strict=True):
            if before is not None:
                after = contact_forces(pair, friction, u, True)
                for weight, at in ((end_weight, after), (1 - end_weight, before)):
                    work += weight * obstacle_work(pair.obstacle, at, self._load, pair.load)
            if friction:
                lost += friction.dissipated(u, end_weight)
        work, lost = self._comm.allreduce(np.array([work, lost])).tolist()
        return work, lost


def contact_forces(
    pair: ContactPair, friction: Friction | None, u: Array, at_end: bool
) -> PointForces:
    """Return the forces of contact and friction on this rank's facets.

    Parameters
    ----------
    pair, friction : ContactPair, Friction or None
        The contact with the obstacle, and its friction.
    u : (local nodes, 3)
        Nodal displacements [m].
    at_end : bool
        Whether ``u`` is the end of a step. The forces of one that is linearised at its start are
        those of the linearisation.
    """
    surface = pair.surface
    which, pressure, normal = pair.end_pressure(u) if at_end else pair.points(u).acting
    found = [(which, (surface.weights[which] * pressure)[..., None] * normal)]
    if friction:
        found.append(friction.weighted_forces(u))
    x = [surface.positions(u, which).reshape(-1, 3) for which, _ in found]
    return PointForces(np.concatenate(x), np.concatenate([f.reshape(-1, 3) for _, f in found]))


def obstacle_work(obstacle: Obstacle, at: PointForces, start: float, end: float) -> float:
    r"""Return the work of forces that move with an obstacle from load ``start`` to ``end`` [J].

    .. math:: W = \sum_q f_q \cdot \tfrac12 \left[d_{0 \to 1}(x_q) - d_{1 \to 0}(x_q)\right]

    with the displacement d of the obstacle's material point at x_q. The central difference leaves
    no work to the normal forces on a body of revolution that turns about its axis.
    """
    if not len(at.x):
        return 0.0
    forth, back = obstacle.displacement(at.x, start, end), obstacle.displacement(at.x, end, start)
    return float((at.forces * (forth - back)).sum() / 2)
