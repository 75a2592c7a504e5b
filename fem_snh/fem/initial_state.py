"""The state in which a run begins, where that is not the body at rest."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh.fem.problem import Problem

#: Nodes are told apart by coordinates rounded to this part of the body's size...
_GRID = 1e-7
#: ... shifted by this part of the grid, so that no mesh has its nodes where rounding changes.
_SHIFT = np.sqrt(2) / 4


def set_initial_state(problem: Problem, start: Any) -> None:
    """Put a start into ``problem.x``: ``map``, ``through``, ``scatter``, ``noise``, ``seed``.

    They are those of `fem_snh.scenes.Start`. All nodes move, those in the middle of edges too;
    what is prescribed at the present load stays. A pressure stays zero. The state is the same on
    any number of ranks. Collective.
    """
    X = problem.coordinates
    low, high = _box(problem.comm, X)
    centre, places = (low + high) / 2, (X - low) / (high - low).max()
    x = X.copy()
    if start.scatter is not None:
        sides = (high - low) * start.scatter ** (1 / 3)
        x = centre + sides * (_random(problem.comm, places, start.seed) - 0.5)
    elif start.map is not None:
        fixed = centre if start.through is None else np.array(start.through)
        x = (X - fixed) @ np.array(start.map).T + fixed
    if start.noise:
        x += start.noise * (2 * _random(problem.comm, places, start.seed, stream=1) - 1)
    problem.x.array[: X.size] = (x - X).ravel()
    problem.prescribe(problem.x)


def _box(comm: MPI.Comm, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest coordinates on all ranks."""
    low, high = X.min(axis=0, initial=np.inf), X.max(axis=0, initial=-np.inf)
    comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
    return low, high


def _random(comm: MPI.Comm, places: np.ndarray, seed: int, stream: int = 0) -> np.ndarray:
    """(n, 3) numbers in [0, 1) for this rank's nodes, whoever has which of them.

    ``places`` (n, 3): where they are in the body, in its sizes. The numbers are drawn for the nodes
    in the order of their places, which every rank finds by itself.
    """
    parts = comm.allgather(np.round(places / _GRID + _SHIFT))
    first = sum(len(part) for part in parts[: comm.rank])
    everyone = np.concatenate(parts)
    drawn = np.empty_like(everyone)
    drawn[np.lexsort(everyone.T)] = np.random.default_rng([seed, stream]).random(everyone.shape)
    return drawn[first : first + len(places)]
