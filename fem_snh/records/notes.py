"""Notes on a result: what its reader must know beside "converged".

A scene's run has them in run.json and in `fem_snh.runs.Result.notes`, a program in
``fem_snh.NonlinearProblem.notes``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

#: The kinds of notes: of the loads; of the output folder; an element that locks; points that are
#: inverted; a jump to a state far away within one step; a surface that is deep in an obstacle or
#: another surface, between the points at which contact acts; penalties that yield; forces that are
#: known to their rounding error; an unstable equilibrium; one other than rest though no load acts;
#: nodes outside of the mesh of the run from which this one starts; rigid motions that nothing
#: constrains, or supports without an area; a pressure that is known up to a constant; cells of the
#: mesh that meet without being connected; a motion that gains energy; PETSc options that no solver
#: has; steps that needed a proximal term.
KINDS = (
    "supports",
    "load",
    "folder",
    "locking",
    "inverted",
    "jump",
    "penetration",
    "penalty",
    "rounding",
    "unstable",
    "rest",
    "start",
    "pressure",
    "mesh",
    "energy",
    "options",
    "stabilised",
)
#: Those on how a state was reached, which hold for what starts from it.
NOTES_ON_PATH = ("jump", "start")


class Note(NamedTuple):
    """A note on a result.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    text : str
        One line: what is the matter, and what to do.
    step : int or None
        Number of the step in ``steps`` of run.json, from 0; None: of the scene or of a program.
    values : mapping
        The numbers of the text, by name.
    """

    kind: str
    text: str
    step: int | None = None
    values: Mapping[str, Any] = {}

    def record(self) -> dict[str, Any]:
        """Return the entry of ``notes`` in run.json."""
        return {"kind": self.kind, "step": self.step, "text": self.text, **self.values}


def with_notes(status: str, number: int) -> str:
    """Return a status with the number of notes: "converged, 2 notes"."""
    return f"{status}, {number} note{'s' if number > 1 else ''}" if number else status
