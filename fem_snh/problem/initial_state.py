"""The initial state of a run that does not start from the undeformed body at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mpi4py import MPI

import numpy as np

from fem_snh.assembly.kinematics import Kinematics
from fem_snh.errors import bad_value, in_words
from fem_snh.problem.problem import Problem

if TYPE_CHECKING:
    from fem_snh.scenes import Start

#: Nodes are identified by their coordinates, rounded to this fraction of the body's extent.
_GRID = 1e-7
#: Offset of the grid, in grid spacings: irrational, so that no node is where rounding is ambiguous.
_SHIFT = np.sqrt(2) / 4


def set_initial_state(problem: Problem, state: Start) -> None:
    """Set the displacement in ``problem.x`` by a map, random positions or noise. Collective.

    All nodes move, also those in the middle of edges; constrained dofs get their values at the
    present load. Unknown pressures stay. The result does not depend on the partition.

    Raises
    ------
    BadInput
        For a map that leaves the plane of a mesh of two dimensions.
    """
    X, kinematics = problem.coordinates, problem.kinematics
    if state.map is not None and kinematics.components == 2 and any(state.map[2][:2]):
        raise bad_value("start.map", state.map, f"a third row [0, 0, 1], in {kinematics.name}")
    low, high = bounding_box(problem.comm, X)
    centre, scaled = (low + high) / 2, (X - low) / (high - low).max()
    x = X.copy()
    if state.scatter is not None:
        sides = (high - low) * state.scatter ** (1 / kinematics.dim)
        x = centre + sides * (_random(problem.comm, scaled, state.seed) - 0.5)
    elif state.map is not None:
        fixed = centre if state.through is None else np.array(state.through)
        x = (X - fixed) @ np.array(state.map).T + fixed
    if state.noise:
        x += state.noise * (2 * _random(problem.comm, scaled, state.seed, stream=1) - 1)
    displacement = problem.x.array[: problem.owned_displacements]
    displacement[:] = (x - X)[:, : kinematics.components].ravel()
    problem.prescribe(problem.x)


def initial_velocity(problem: Problem, state: Start) -> Callable[[np.ndarray], np.ndarray] | None:
    r"""Return the initial velocity as a function of the reference coordinates. Collective.

    .. math:: v(X) = v_0 + \omega \times (X + u(X) - c)

    with the displacement ``problem.u`` and a point c of the axis: ``state.through``, by default the
    centre of the bounding box; on a body of revolution the origin.

    Returns
    -------
    callable or None
        A function of coordinates (local nodes, 3) [m], ghosts included, that returns velocities
        (local nodes, components) [m/s]; None if the state has no velocity.

    Raises
    ------
    BadInput
        For a velocity that the kinematics does not have.
    """
    if state.velocity is None and state.angular_velocity is None:
        return None
    kinematics = problem.kinematics
    _check_velocity(kinematics, "velocity", state.velocity, kinematics.axes)
    spins = "xyz" if kinematics.dim == 3 else "y" if kinematics.revolved else "z"
    spins = "" if kinematics.name == "axisymmetric" else spins
    _check_velocity(kinematics, "angular_velocity", state.angular_velocity, spins)
    low, high = bounding_box(problem.comm, problem.coordinates)
    fixed = (low + high) / 2 if state.through is None else np.array(state.through)
    if kinematics.revolved:
        fixed = np.zeros(3)

    def velocity(X: np.ndarray) -> np.ndarray:
        v, u = np.zeros_like(X), kinematics.padded(problem.u.x.array)
        if state.velocity is not None:
            v += np.array(state.velocity)
        if state.angular_velocity is not None:
            v += np.cross(state.angular_velocity, X + u - fixed)
        return v[:, : kinematics.components]

    return velocity


def _check_velocity(
    kinematics: Kinematics, key: str, value: Sequence[float] | None, axes: Sequence[str]
) -> None:
    """Raise BadInput if a component of a vector along an axis not in ``axes`` is not zero."""
    if any(number and axis not in axes for axis, number in zip("xyz", value or (), strict=False)):
        accepted = in_words(axes) if axes else "none"
        accepted = f"only these components: {accepted}, in {kinematics.name}"
        raise bad_value(f"start.{key}", list(value or ()), accepted)


def bounding_box(comm: MPI.Comm, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest coordinates, (3,) each, of the points X (n, 3) of all ranks.

    Collective; inf and -inf without a point.
    """
    low, high = X.min(axis=0, initial=np.inf), X.max(axis=0, initial=-np.inf)
    comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
    return low, high


def _random(comm: MPI.Comm, scaled: np.ndarray, seed: int, stream: int = 0) -> np.ndarray:
    """Return random numbers in [0, 1) for this rank's nodes, (n, 3). Collective.

    ``scaled`` (n, 3) are the nodes' coordinates relative to the body's extent. Rank 0 draws the
    numbers of all nodes in the order of their coordinates, so the partition has no influence.
    """
    parts, drawn = comm.gather(np.round(scaled / _GRID + _SHIFT)), None
    if parts:
        nodes = np.concatenate(parts)
        order, numbers = np.lexsort(nodes.T), np.empty_like(nodes)
        numbers[order] = np.random.default_rng([seed, stream]).random(nodes.shape)
        drawn = np.split(numbers, np.cumsum([len(part) for part in parts])[:-1])
    return np.asarray(comm.scatter(drawn))
