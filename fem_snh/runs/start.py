"""Start from the state of another run: ``[start] run`` of scenes, and a function for programs.

The displacement of a stored state is interpolated if the mesh is another one. Loads and contact of
the other run are not taken over: from the first step, those of the new problem act.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.contact.obstacle import names as obstacle_names
from fem_snh.errors import ResultNote, in_words, on_root
from fem_snh.problem.definition import check_displacement
from fem_snh.problem.problem import Problem
from fem_snh.records.run_record import Note, Record, load_record
from fem_snh.runs.output.nodal_values import gather_rows, scatter_rows
from fem_snh.scenes import Scene


def interpolate_run(
    u: _dolfinx.Function, run: str | Path, step: int = -1, *, kinematics: str | None = None
) -> None:
    """Set the displacement of a program to the displacement of a run. Collective.

    ``NonlinearProblem.steps`` then goes from these values at constrained nodes to those of ``bcs``.
    A node outside of the run's mesh has the value of the closest point.

    Parameters
    ----------
    u : dolfinx Function
        The displacement, on any mesh of the run's body.
    run : str or Path
        The folder of the run.
    step : int, optional
        Number of the run's stored state: 0 is the start, -1 the last state.
    kinematics : str, optional
        The kinematics of a mesh of two dimensions.

    Raises
    ------
    BadInput
        On every rank, if the run has no such state, or is of another body.

    Warns
    -----
    ResultNote
        On rank 0, if nodes are outside of the run's mesh.

    Examples
    --------
    >>> fem_snh.interpolate_run(u, "out/press")
    >>> for step in problem.steps(4):
    ...     print(step["load"], step["newton"])
    """
    check_displacement(u, kinematics)
    values, note = _displacement(u.function_space, Path(run), step, kinematics)
    u.x.array[: values.size] = values.ravel()
    u.x.scatter_forward()
    if note and u.function_space.mesh.comm.rank == 0:
        warnings.warn(note.text, ResultNote, stacklevel=2)


def start_from_run(problem: Problem, scene: Scene, read: bool = True) -> Note | None:
    """Set ``problem.x`` to the displacement of ``start.run``, at load 0. Collective.

    Prescribed displacements start from this displacement. A pressure unknown is not set. If
    ``read`` is false, nothing is read: the caller sets the state from a checkpoint.

    Returns
    -------
    Note or None
        How many nodes are outside of the run's mesh, and which obstacles lose their friction.

    Raises
    ------
    BadInput
        On every rank, if the run has no such state, or is of another body.
    """
    start = scene.start
    assert start is not None and start.run is not None
    problem.dirichlet.offset = np.zeros(len(problem.dirichlet.dofs))
    if not read:
        return None
    name = None if problem.kinematics.dim == 3 else problem.kinematics.name
    values, note = _displacement(problem.V, start.run, start.step, name)
    problem.x.array[: values.size] = values.ravel()
    problem.dirichlet.start_from(problem.x)
    problem.set_load(0.0)
    problem.prescribe(problem.x)
    problem.split(problem.x)
    lost = on_root(problem.comm, _friction_text, scene, start.run)
    texts = ([note.text] if note else []) + ([lost] if lost else [])
    return Note("start", "; ".join(texts)) if texts else None


def _friction_text(scene: Scene, run: Path) -> str:
    """Return a text on the obstacles whose friction in the run is lost; "" if there are none."""
    steps = load_record(run / "run.json")["steps"]
    row: Record = next((row for row in reversed(steps) if row["converged"]), {})
    names = [name for name, o in zip(obstacle_names(scene.obstacle), scene.obstacle) if o.friction]
    touched = [f"'{n}'" for n in names if row.get("obstacles", {}).get(n, {}).get("contacts")]
    if not touched:
        return ""
    return (
        f"start.run = '{run}': friction with {in_words(touched)} begins without the shear stress "
        "that it has there: the surface sticks where it is, and what friction alone held springs "
        "back; within one run friction keeps it: take a force with a 'table' that returns to zero "
        "in place of a second run"
    )


def _displacement(
    V: _dolfinx.FunctionSpace, run: Path, step: int, kinematics: str | None
) -> tuple[Array, Note | None]:
    """Return a run's displacement at the owned nodes, (n, components), and a note. Collective."""
    comm, owned = V.mesh.comm, _dolfinx.num_nodes(V)[0]
    components = _dolfinx.num_components(V)
    nodes = gather_rows(comm, V.tabulate_dof_coordinates()[:owned])
    read: list[Array] = []

    def interpolate() -> str:
        from fem_snh.viewing.states import displacement_at

        found, distance = displacement_at(run, step, kinematics, nodes)
        read.append(found[:, :components])
        outside = np.count_nonzero(distance)
        if not outside:
            return ""
        return (
            f"start.run = '{run}': {outside} of {len(nodes)} nodes are outside of its mesh, by at "
            f"most {distance.max():.3g}: they have the displacement of its closest point"
        )

    text = on_root(comm, interpolate)
    values = scatter_rows(comm, read[0] if read else None, (owned, components))
    return values, Note("start", text) if text else None
