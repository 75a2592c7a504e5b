"""The notes of a run: what its rows and its last state say beside "converged"."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_snh.mesh.mesh_checks import unconnected_nodes
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import (
    energy_note,
    instability_note,
    penetration_note,
    stabilisation_note,
    state_notes,
    targets_note,
)
from fem_snh.records.run_record import Note, Record
from fem_snh.scenes import Lattice, Scene
from fem_snh.terms.dirichlet import Move
from fem_snh.terms.rigid import Rigid

if TYPE_CHECKING:
    from fem_snh.runs.setup import Setup


def turns(scene: Scene) -> list[str]:
    """Return a line for each prescribed rotation by more than half a turn per step.

    Half a turn and one and a half end in the same position, so whole turns may be lost.
    """
    steps = scene.time.steps if scene.time else scene.steps
    found = []
    turning: dict[str, Sequence[Move | Rigid]] = {"move": scene.move, "rigid": scene.rigid}
    for key, tables in turning.items():
        for i, table in enumerate(tables):
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


def kinks(scene: Scene) -> list[str]:
    """Return a line for each table whose kinks make velocities jump in a dynamic scene."""
    if not scene.time:
        return []
    motions: list[Any] = [*scene.move, *scene.rigid]
    motions += [motion.rotate for motion in motions if motion.rotate]
    moved = {motion.table for motion in motions}
    return [
        f"the velocity of table {table.name!r} jumps at its points, which are farther apart than "
        "the time steps: forces of inertia there grow as the steps become shorter, and a stiff "
        "body rings; of a record take interpolation = 'smooth'"
        for table in scene.table
        if table.name in moved and table.has_kinks(scene.time.duration / scene.time.steps)
    ]


def partial_rotation_notes(scene: Scene) -> list[str]:
    """Return a line for each rotation that does not prescribe all components that it moves."""
    known = "xyz" if scene.kinematics in (None, "axisymmetric_torsion") else "xy"
    found = []
    for i, table in enumerate(scene.move):
        if table.rotate is None or not table.rotate.angle:
            continue
        # A rotation moves points in every direction but that of its axis.
        still = [known[j] for j in range(len(known)) if not any(np.delete(table.rotate.axis, j))]
        left = [axis for axis in known if axis not in (*table.components, *still)]
        if left:
            found.append(
                f"move.{i}.rotate moves points along {', '.join(left)} too, which its components "
                f"leave out: with {', '.join(table.components)} alone they do not turn by the angle"
            )
    return found


def shape_notes(scene: Scene) -> list[str]:
    """Return a line if the mesh differs from the body, a difference that no estimate includes."""
    if not scene.estimates_error:
        return []
    if isinstance(scene.mesh, Lattice):
        part = "by the part" if scene.mesh.weighting == "fraction" else "in full, not by the part"
        return [
            f"cells that the surface cuts count {part} of them that is inside: the estimated "
            "errors are those of this lattice; that of the shape shows with half the cell, "
            f"mesh.cell = {scene.mesh.cell / 2:g}"
        ]
    from fem_snh.runs.level_meshes import has_polyhedral_cells

    if not has_polyhedral_cells(scene):
        return []
    return [
        "the body has round faces, and its cells straight edges: the estimated errors are those of "
        "that polyhedron; order = 2 gives cells with curved faces"
    ]


def mesh_note(scene: Scene, problem: Problem) -> Note | None:
    """Return a note if the cells of a mesh file are not connected where they meet. Collective.

    None with contact, which acts between surfaces that are not connected.
    """
    if not isinstance(scene.mesh, Path) or scene.contact or scene.self_contact:
        return None
    count, first = unconnected_nodes(problem.domain)
    if not count:
        return None
    where = ", ".join(f"{value:.6g}" for value in first)
    text = (
        f"at {count} places, one at ({where}), several nodes of the mesh's boundary coincide: its "
        "cells are not connected there, and separate or overlap freely; where they should be "
        "connected, let the volumes share their surfaces (gmsh: Coherence or BooleanFragments)"
    )
    return Note("mesh", text, None, {"places": count, "position": first.tolist()})


def final_notes(setup: Setup, steps: Sequence[Record]) -> list[Note]:
    """Return the notes on the last state of a run, and on earlier states. Collective.

    Parameters
    ----------
    setup : Setup
        The problem in the state of the last step that converged.
    steps : sequence of mapping
        The rows of run.json.
    """
    good = [number for number, row in enumerate(steps) if row["converged"]]
    if not good:
        return []
    problem = setup.problem
    stabilised = {
        number: float(steps[number]["stabilisation"])
        for number in good
        if "stabilisation" in steps[number]
    }
    rounding = setup.snes.getPythonContext().rounding
    found = state_notes(problem, rounding, good[-1])
    rows = {number: steps[number] for number in good}
    negative = {number: row.get("negative_eigenvalues", 0) for number, row in rows.items()}
    further = [
        None if any(n.kind == "inverted" for n in found) else _earlier_inversion(steps, good),
        energy_note(rows),
        penetration_note(rows),
        targets_note(rows),
        instability_note(negative, problem, len(good), good[-1]),
        stabilisation_note(stabilised, len(good)),
    ]
    return [*found, *filter(None, further)]


def _earlier_inversion(steps: Sequence[Record], good: Sequence[int]) -> Note | None:
    """Return a note if quadrature points were inverted in one of the steps ``good``."""
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
