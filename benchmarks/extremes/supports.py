"""The family "supports": bodies with no supports, or too few.

Blocks on rollers, in three dimensions, in plane strain and of revolution. The rigid motions that
nothing constrains are named before the first step: in a note, or under a net force in the one line
with which the scene is refused. In time a free motion is no mistake.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from benchmarks.extremes import bodies
from benchmarks.extremes.cases import Case, Record, Row, scene_case

#: The bodies, and the result: "held", "one of many" equilibria, "refused", "by contact" alone.
_CASES: dict[str, tuple[dict[str, Any], str]] = {
    "held": ({"planes": "xyz", "load": 0.01}, "held"),
    "none": ({"planes": ""}, "one of many"),
    "none-loaded": ({"planes": "", "load": 0.01}, "refused"),
    "one": ({"planes": "x"}, "one of many"),
    "too-few": ({}, "one of many"),
    "too-few-loaded": ({"load": 0.01}, "refused"),
    "too-few-in-time": ({"load": 0.01, "moving": True}, "held"),
    "none-in-time": ({"planes": "", "load": 0.01, "moving": True}, "held"),
    "two-bodies": ({"planes": "xyz", "bodies": 2}, "one of many"),
    "two-bodies-loaded": ({"planes": "xyz", "bodies": 2, "load": 0.01}, "refused"),
    "two-bodies-touch": ({"planes": "xyz", "bodies": 2, "touch": True}, "by contact"),
    "plane-loaded": ({"planes": "x", "load": 0.01, "kinematics": "plane_strain"}, "refused"),
    "plane": ({"planes": "xy", "load": 0.01, "kinematics": "plane_strain"}, "held"),
    "axisymmetric-loaded": ({"planes": "", "load": 0.01, "kinematics": "axisymmetric"}, "refused"),
    "axisymmetric": ({"planes": "", "kinematics": "axisymmetric_torsion"}, "one of many"),
}
#: What ends each, in words.
_CRITERIA = {
    "held": "converges, without a note",
    "one of many": "converges; a note names the motions",
    "by contact": "converges or stops; a note says that contact alone holds the body",
    "refused": "is refused in one line that names the motions",
}
_NOTE = {"one of many": "one of many", "by contact": "contact alone can hold it"}


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases; the quick ones are some of all kinds."""
    some = ("none-loaded", "too-few", "plane-loaded", "too-few-in-time")
    made = []
    for name, (keys, result) in _CASES.items():
        if name in some or not quick:
            case = scene_case(
                bodies.reference(bodies.rollers), f"supports-{name}", _CRITERIA[result],
                partial(_ends, result), **keys,
            )  # fmt: skip
            made.append(replace(case, refused=result == "refused"))
    return made


def _ends(result: str, record: Record, row: Row) -> str:
    """Check the end of a run and its note."""
    status = str(row["status"])
    if result == "refused":
        named = status.startswith("supports: nothing constrains") and "loads act" in status
        return "" if named else status
    texts = [note["text"] for note in record.get("notes", ()) if note["kind"] == "supports"]
    if result == "held" and texts:
        return texts[0]
    if result != "held" and not any(_NOTE[result] in text for text in texts):
        return "no note on supports"
    return "" if result == "by contact" or row["converged"] is True else status
