"""Write checkpoint.npz: the state from which a run is resumed on any number of ranks.

It holds displacement and pressure with the reference coordinates of their nodes, by which another
partition of the mesh finds them; the size of the next step; the previous equilibrium, from which
the predictor extrapolates; in time, velocity, acceleration and the step before; what terms keep, as
multipliers of contact; and the diagonal entry of constrained rows. On the same number of ranks a
resumed run is therefore identical bit for bit, unless a preconditioner of PETSc keeps data from
step to step, as GAMG keeps its coarse spaces.

Its size is 72 bytes per node, 24 MB for a million unknowns, which rank 0 writes in 0.2 s.
"""

from __future__ import annotations

import json
from io import BytesIO
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fem_snh.errors import on_root
from fem_snh.files import replace_file
from fem_snh.problem.problem import Problem
from fem_snh.records.run_files import CHECKPOINT
from fem_snh.runs.folder import Folder
from fem_snh.runs.output import nodal_values
from fem_snh.runs.output.nodal_values import gather_rows
from fem_snh.runs.scene_options import identity

if TYPE_CHECKING:
    from fem_snh.runs.setup import Setup
    from fem_snh.steps.dynamics.dynamics import Dynamics

Array = npt.NDArray[Any]

#: The array of `StartPath.offset` at the nodes of the displacement.
OFFSET = "start_offset"
#: Seconds between two checkpoints that are flushed to the disk. A flush takes longer than many
#: steps; a loss of power costs at most this time.
_FLUSH_INTERVAL = 1.0


class CheckpointWriter:
    """The writer of a run's checkpoint; its methods are collective.

    Parameters
    ----------
    folder : Folder
        The folder of the output.
    setup : Setup
        The load steps, and the scene, with which that of a resumed run is compared.
    """

    def __init__(self, folder: Folder, setup: Setup) -> None:
        self._folder, self._stepper = folder, setup.stepper
        self._scene = on_root(folder.comm, identity, setup.scene)
        self._fields = nodal_values.fields(setup.problem)
        self._flushed = -_FLUSH_INTERVAL

    def write(self, record: dict[str, Any]) -> None:
        """Write the state and the content of run.json.

        Raises
        ------
        BadInput
            On every rank, if the file cannot be written.
        """
        problem, before = self._stepper.problem, self._stepper.solver.predictor.before
        arrays = {}
        for name, field in self._fields.items():
            arrays[f"{name}_nodes"], arrays[name] = field.nodes, field.gather(problem.x)
            if before:
                arrays[f"{name}_before"] = field.gather(before[1])
        arrays |= gather_terms(problem)
        path = problem.dirichlet.path
        if path is not None:
            offset = problem.x.duplicate()
            offset.array[problem.dirichlet.dofs] = path.offset
            arrays[OFFSET] = self._fields["u"].gather(offset)
        motion: dict[str, Any] | None = None
        if steps := self._stepper.motion:
            arrays["motion"], motion = gather_motion(problem, steps.dynamics)
        about = {
            "scene": self._scene,
            "record": record,
            "load": problem.load,
            "load_before": before[0] if before else None,
            "size": self._stepper.size.next,
            "motion": motion,
            "diagonal": problem.matrix.constrained_diagonal,
        }
        on_root(self._folder.comm, self._write, about, arrays)

    def _write(self, about: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Replace the file on rank 0."""
        # Unlike run.json, the text keeps infinities; numpy's numbers become Python's.
        text = json.dumps(about, default=lambda v: v.item()).encode()
        content: dict[str, Any] = {"about": np.frombuffer(text, np.uint8), **arrays}
        flush = monotonic() > self._flushed + _FLUSH_INTERVAL
        path = self._folder.path / CHECKPOINT
        self._folder.announce(CHECKPOINT)
        # Where the disk is full, zipfile would report it a second time when Python deletes it.
        archive = BytesIO()
        np.savez(archive, **content)
        replace_file(path, lambda file: file.write(archive.getbuffer()), sync=flush)
        if flush:
            self._flushed = monotonic()


def history_names(term: str) -> tuple[str, str]:
    """Return the names of the arrays with a term's points and with what it keeps there."""
    return f"{term}_points", f"{term}_history"


def gather_motion(problem: Problem, dynamics: Dynamics) -> tuple[Array, dict[str, Any]]:
    """Return `Dynamics.history` with the rows of all ranks on rank 0. Collective."""
    values, about = dynamics.history()
    return gather_rows(problem.comm, values), about


def gather_terms(problem: Problem) -> dict[str, Array]:
    """Return what the terms keep at their points, on rank 0. Collective."""
    arrays = {}
    for name, term in problem.history.by_name.items():
        points, values = term.history()
        for key, rows in zip(history_names(name), (points, values), strict=True):
            arrays[key] = gather_rows(problem.comm, rows)
    return arrays
