"""The notes of a run: what its rows and its last state say beside "converged"."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from fem_snh.accuracy.state_notes import (
    instability_note,
    inversion_note,
    locking_note,
    penetration_note,
    pressure_note,
)
from fem_snh.assembly.elements import Element
from fem_snh.contact.contact import ContactTable
from fem_snh.notes import Note
from fem_snh.problem.problem import Problem
from fem_snh.scenes import Scene

#: Makes the run's problem with another element.
Make = Callable[[Element], Problem]


def turns(scene: Scene) -> list[str]:
    """Return a line for each prescribed rotation by more than half a turn a step.

    The pose at a load does not tell a turn from a turn and a half: the body follows whichever its
    states before lead to.
    """
    steps = scene.time.steps if scene.time else scene.steps
    found = []
    for key in ("move", "rigid"):
        for i, table in enumerate(getattr(scene, key)):
            rotate = table.rotate
            if rotate is None or table.table is not None or rotate.table is not None:
                continue
            if abs(rotate.angle) > steps * math.pi * (1 + 1e-9):
                degrees, least = math.degrees(rotate.angle), math.ceil(abs(rotate.angle) / math.pi)
                found.append(
                    f"{key}.{i}.rotate turns by {degrees:.6g} degrees in {steps} "
                    f"step{'s' if steps > 1 else ''}, more than half a turn in one: whole turns "
                    f"may be lost; take at least {least} steps"
                )
    return found


def final_notes(
    problem: Problem,
    steps: Sequence[Mapping[str, Any]],
    make: Make | None,
    estimated: Scene | None = None,
) -> list[Note]:
    """Return the notes on the last state of a run, and on states before it. Collective.

    Parameters
    ----------
    problem : Problem
        The problem in the state of the last step that converged.
    steps : sequence of mapping
        The rows of run.json.
    make : callable or None
        Makes the problem with another element, by which a stiffness is compared.
    estimated : Scene, optional
        The scene, if its goals have estimated errors.
    """
    good = [number for number, row in enumerate(steps) if row["converged"]]
    if not good:
        return []
    stiffness = None
    if make:
        from fem_snh.accuracy.stiffness import stiffness_factor

        stiffness = partial(stiffness_factor, make=make)
    found = [
        locking_note(problem, stiffness, good[-1]),
        inversion_note(problem, good[-1]) or _earlier_inversion(steps, good),
        pressure_note(problem),
        penetration_note({number: steps[number] for number in good}),
        penalty_note(estimated, steps) if estimated and estimated.time else None,
        instability_note(
            {number: steps[number].get("negative_eigenvalues", 0) for number in good},
            len(good),
            good[-1],
        ),
    ]
    return [note for note in found if note]


def penalty_note(scene: Scene, steps: Sequence[Mapping[str, Any]]) -> Note | None:
    """Return a note if surfaces are in contact by a penalty, which errors in time leave out.

    The motion that is followed again has the same penalty.
    """
    row = steps[-1]
    obstacles = zip(scene.obstacle, row.get("obstacles", {}).items(), strict=False)
    pairs = zip(scene.contact, row.get("contacts", {}).items(), strict=False)
    found = [
        (f"{table.key} '{name}'", float(about["penetration"]))
        for table, (name, about) in (*obstacles, *pairs)
        if about["contacts"] and isinstance(table, ContactTable) and not table.augmented
    ]
    if not found:
        return None
    name, depth = max(found, key=lambda pair: pair[1])
    others = [other for other, _ in found if other != name]
    also = f" (and {', '.join(others)})" if others else ""
    text = (
        f"the estimated errors leave out the penalty of {name}{also}, which lets a surface "
        f"{depth:.3g} m in: compare method = 'augmented_lagrangian', or a larger stiffness"
    )
    return Note("penalty", text, len(steps) - 1, {"name": name, "penetration": depth})


def _earlier_inversion(steps: Sequence[Mapping[str, Any]], good: Sequence[int]) -> Note | None:
    """Return a note if points were inverted in a state before the last one."""
    inverted = [number for number in good if steps[number]["min_J"] <= 0]
    if not inverted:
        return None
    worst = min(inverted, key=lambda number: float(steps[number]["min_J"]))
    row = steps[worst]
    text = (
        f"quadrature points are inverted in {len(inverted)} of {len(good)} steps, not in the last: "
        f"smallest J = {row['min_J']:.3g} at load {row['load']:.6g}, where the means over cells, "
        f"which fields and pictures show as J, are at least {row['min_cell_J']:.3g}"
    )
    values = {"steps": inverted, "min_J": row["min_J"], "min_cell_J": row["min_cell_J"]}
    return Note("inverted", text, worst, values)
