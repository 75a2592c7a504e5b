"""Smith et al. 2018, Figures 1, 7 and 8: flesh on the bones of a hand and of a torso."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from benchmarks import Row, split_list
from fem_snh import scenes
from fem_snh.runs import run


class Published(NamedTuple):
    """What the paper states of a scene: its mesh, and the means over its steps."""

    cells: int
    newton: float
    linear: float
    seconds: float


#: Captions of Figures 7 and 1.
PAPER = {
    "hand": Published(41_050, 15.9, 9_486.7, 53.8),
    "torso": Published(45_809, 13.7, 5_860, 25.6),
}
#: Meshes whose numbers of cells differ by at most this part count as the same size.
SAME_SIZE = 0.1
#: Limits: seconds over the paper's; penetration in cells, and solves of a step, of the torso.
SECONDS, PENETRATION, SOLVES = 0.5, 0.05, 5


def rows(
    scene: str = "hand,torso",
    materials: str = "stable_neo_hookean",
    cells: int = 0,
    steps: int = 0,
    contact: bool = True,
    out: str = "",
) -> Iterator[Row]:
    """Yield a row for each scene and material, with the means over the scene's steps.

    Parameters
    ----------
    scene : str
        Scenes: hand, torso.
    materials : str
        Names of materials.
    cells : int
        Cells along the body; 0: the scene's number, with which it is as large as the paper's.
    steps : int
        Number of load steps; 0: the scene's.
    contact : bool
        Whether parts of the surface push each other apart.
    out : str
        Folder in which the runs are kept; by default nothing is written.
    """
    for name in split_list(scene):
        parameters: dict[str, Any] = {"contact": contact}
        if cells:
            parameters["cells"] = cells
        for material in split_list(materials):
            keys = {"steps": steps} if steps else {}
            chosen = scenes.load(name, material=material, **keys, **parameters)
            yield measure(chosen, f"{out}/{name}-{material}" if out else None)


def measure(scene: scenes.Scene, out: str | None = None) -> Row:
    """Return the row of one run. Collective.

    Means are over the scene's steps up to the last load; a halved step counts as one, with all of
    its attempts. ``most_newton`` is of one attempt.
    """
    result = run(scene, out=out, overwrite=True, progress=False)
    record, steps = result.record, result.steps
    accepted = [step for step in steps if step["converged"]]
    load = accepted[-1]["load"] if accepted else 0.0
    done = scene.steps * load or float("nan")
    row: Row = {
        "scene": scene.name,
        "material": record["material"]["name"],
        "bones": len(scene.bone),
        "cells": record["cells"],
        "dofs": record["dofs"],
        "ranks": record["ranks"],
        "status": result.status,
        "load": load,
        "steps": len(steps),
        "rejected": len(steps) - len(accepted),
        "newton": sum(step["newton"] for step in steps) / done,
        "most_newton": max(step["newton"] for step in steps),
        "linear": sum(step["linear"] for step in steps) / done,
        "seconds": sum(step["seconds"] for step in steps) / done,
        "processor_seconds": record["processor_seconds"] / done,
        "residual": max((step["residual"] for step in accepted), default=float("nan")),
        "volume": accepted[-1]["volume_ratio"] if accepted else 1.0,
        "min_J": min((step["min_J"] for step in accepted), default=1.0),
    }
    contacts = [step["self_contact"] for step in accepted if "self_contact" in step]
    if contacts:
        size = scene.mesh.cell  # type: ignore[union-attr]  # the scenes are lattices
        row |= {
            "solves": max(step["solves"] for step in accepted),
            "penetration": max(contact["penetration"] for contact in contacts) / size,
            "force": contacts[-1]["force"],
            "pairs": contacts[-1]["pairs"],
        }
    paper = PAPER.get(scene.name)
    if paper and row["material"] == "stable_neo_hookean":
        row["ok"] = result.converged
        if abs(row["cells"] / paper.cells - 1) < SAME_SIZE:
            row |= {"paper_newton": paper.newton, "paper_seconds": paper.seconds}
            row["ok"] &= row["rejected"] == 0 and row["newton"] <= paper.newton
            row["ok"] &= row["ranks"] > 2 or row["seconds"] <= SECONDS * paper.seconds
            if scene.name == "torso" and contacts:
                row["ok"] &= row["solves"] <= SOLVES and row["penetration"] <= PENETRATION
    return row
