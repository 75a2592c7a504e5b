"""What a checkpoint holds of a run's past: the motion in time, and what the terms keep.

Arrays are on rank 0, with the reference coordinates by which another partition finds its rows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from fem_snh.errors import BadInput, on_root
from fem_snh.problem.problem import Problem
from fem_snh.runs.output.nodal_values import gather_rows, match_nodes, scatter_rows

if TYPE_CHECKING:
    from fem_snh.steps.dynamics.dynamics import Dynamics

Array = npt.NDArray[Any]
#: Names of the arrays of a term's history.
_POINTS, _VALUES = "{}_points", "{}_history"


def gather_motion(problem: Problem, dynamics: Dynamics) -> tuple[Array, dict[str, Any]]:
    """Return `Dynamics.history` with the rows of all ranks on rank 0. Collective."""
    values, about = dynamics.history()
    return gather_rows(problem.comm, values), about


def restore_motion(
    problem: Problem, dynamics: Dynamics, values: Array | None, about: dict[str, Any]
) -> None:
    """Continue the motion from the ``values`` on rank 0, in the order of the nodes. Collective."""
    comm = problem.comm
    columns = comm.bcast(None if values is None else values.shape[1])
    own = scatter_rows(comm, values, (len(problem.coordinates), columns))
    dynamics.set_history(own, about)


def gather_terms(problem: Problem) -> dict[str, Array]:
    """Return what the terms keep at their points, on rank 0. Collective."""
    arrays = {}
    for name, term in problem.history.by_name.items():
        points, values = term.history()
        arrays[_POINTS.format(name)] = gather_rows(problem.comm, points)
        arrays[_VALUES.format(name)] = gather_rows(problem.comm, values)
    return arrays


def restore_terms(problem: Problem, arrays: dict[str, Array]) -> None:
    """Set what the terms keep at their points. Collective.

    Raises
    ------
    BadInput
        On every rank, if the points are not those of the checkpoint.
    """
    for name, term in problem.history.by_name.items():
        points, values = term.history()
        wanted = gather_rows(problem.comm, points)
        order = on_root(problem.comm, _rows_of, name, wanted, values.shape[1], arrays)
        kept = None if problem.comm.rank else arrays[_VALUES.format(name)][order]
        term.set_history(scatter_rows(problem.comm, kept, values.shape))


def _rows_of(name: str, wanted: Array, columns: int, arrays: dict[str, Array]) -> Array:
    """Return the rows of a term's arrays that belong to points; BadInput if they do not fit."""
    points, values = (arrays.get(key.format(name)) for key in (_POINTS, _VALUES))
    if points is None or values is None or points.ndim != 2 or points.shape[1] != 3:
        raise BadInput(f"the checkpoint has no history of {name}: start again with --overwrite")
    if values.shape != (len(points), columns):
        raise BadInput(
            f"the checkpoint has a history of {name} of shape {values.shape}, expected "
            f"{(len(points), columns)}: start again with --overwrite"
        )
    return match_nodes(wanted, points)
