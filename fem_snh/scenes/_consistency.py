"""Checks of a scene's keys against each other, after each of them is valid by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fem_snh.assembly.elements import ELEMENTS, element
from fem_snh.assembly.kinematics import PLANAR, kinematics_of
from fem_snh.choices import COARSER_MESHES, LIFTED_ELEMENT
from fem_snh.contact.obstacle import names as obstacle_names
from fem_snh.errors import BadInput, bad_value, in_words
from fem_snh.files import is_shape
from fem_snh.records.output_fields import IN_TIME, NODAL
from fem_snh.scenes._bones import check_bones
from fem_snh.scenes._outputs import Accuracy, Geometry, Lattice, Tetrahedra, read_goal, term_goals
from fem_snh.tables.amplitudes import check_tables
from fem_snh.tables.types import MAX_CELLS
from fem_snh.tables.validation import check_distinct
from fem_snh.terms.feature import feature_classes, grouped

if TYPE_CHECKING:
    from fem_snh.scenes.schema import Hold, Move, Scene

#: Keys that no scene in time has. Modes are those of a state at rest; continuation in Poisson's
#: ratio solves problems without inertia; stability is that of an equilibrium.
_QUASI_STATIC = ("modes", "nu_continuation", "stability")

#: Keys that scenes of two dimensions do not have.
_SOLID = ("bone", "rig")

#: Tables with a key ``group``.
_GROUP_TABLES = ("hold", "move", "symmetry", "bone")


def check_consistency(scene: Scene) -> None:
    """Raise BadInput for the first contradiction between keys of a scene."""
    kinematics = kinematics_of(scene.kinematics)
    element(scene.element, scene.quadrature, kinematics)
    if scene.kinematics:
        _check_plane(scene)
    check_tables(scene.table, dict(scene))
    for kind, features in grouped(scene.features):
        kind.check(features, scene)
    check_distinct("probe.name", [probe.name for probe in scene.probe], "probe")
    check_bones(scene.bone, scene.rig, obstacle_names(scene.obstacle))
    if scene.predictor == "bones" and (scene.time or not scene.bone):
        why = "[time]" if scene.time else "no [[bone]]"
        raise bad_value("predictor", "bones", f"another one, as the scene has {why}")
    if scene.static_condensation and ELEMENTS[scene.element].volume != "mean":
        raise bad_value("static_condensation", "true", f"no value, as {why_condensed(scene)}")
    if scene.static_condensation is False and (why := why_condensed(scene)):
        raise bad_value("static_condensation", "false", f"true, as {why}")
    _check_continuation(scene)
    _check_fields(scene)
    _check_mesh(scene)
    if scene.modes and scene.modes.density and all(m.density for m in scene.materials):
        accepted = "no value, as each material has its density"
        raise bad_value("modes.density", scene.modes.density, accepted)
    _check_loads(scene)
    results = term_goals(scene.features)
    for reaction in scene.reactions:
        if f"{reaction.group}.force" in results:  # two columns of one name in steps.csv
            accepted = "a group of another name than that of an obstacle or contact"
            raise bad_value("reactions", reaction.group, accepted)
    if scene.accuracy:
        _check_accuracy(scene.accuracy, scene)
    if scene.time:
        _check_time(scene)
    else:
        _check_quasi_static(scene)
    _check_constraints(scene.hold, scene.move)


def _check_accuracy(accuracy: Accuracy, scene: Scene) -> None:
    """Raise BadInput for a goal that the scene does not have.

    In plane stress the thickness, and on a lattice the fraction of a cell that the body fills, are
    no functions of the displacement that UFL derives.
    """
    if accuracy.estimate == COARSER_MESHES:
        reasons = {
            "as accuracy.within is given": accuracy.within is not None,
            "in time": scene.time is not None,
            "as the mesh of a file has no coarser one": isinstance(scene.mesh, Path)
            and scene.cells is None,
        }
        if reason := next((text for text, applies in reasons.items() if applies), ""):
            accepted = f"{LIFTED_ELEMENT}, {reason}"
            raise bad_value("accuracy.estimate", COARSER_MESHES, accepted)
    sheet = kinematics_of(scene.kinematics).plane_stress
    for goal in accuracy.names:
        kind = read_goal(goal, scene).kind
        if kind in ("stress", "stress_at") and (sheet or isinstance(scene.mesh, Lattice)):
            accepted = "another goal than a stress, on a lattice and in plane stress"
            raise bad_value("accuracy.goals", goal, accepted)
    _check_loads_of_goals(accuracy, scene)


def _check_loads_of_goals(accuracy: Accuracy, scene: Scene) -> None:
    """Raise BadInput for the load of a goal that has none, or at which no step ends."""
    loads: dict[tuple[str, str], object] = {}
    for number, goal in enumerate(accuracy.goals):
        at, key = goal.at, f"accuracy.goals.{number}.at"
        kind, name, _ = read_goal(goal.name, scene)
        if (other := loads.setdefault((kind, name), at)) != at:
            raise bad_value(key, at, f"{other}, as for another component")
        if at is None:
            continue
        reasons = {
            "in time": scene.time is not None,
            "as frequencies are computed at the end": kind == "frequency",
            f"with accuracy.estimate = '{COARSER_MESHES}'": accuracy.estimate == COARSER_MESHES,
        }
        if reason := next((text for text, applies in reasons.items() if applies), ""):
            raise bad_value(key, at, f"no value, {reason}")
        if isinstance(at, float) and (at == 0 or round(at * scene.steps) / scene.steps != at):
            raise bad_value(key, at, f"the load of one of the {scene.steps} steps")


def _check_loads(scene: Scene) -> None:
    """Raise BadInput for values of tables that a scene without time does not reach."""
    for number, table in enumerate(() if scene.time else scene.table):
        ends = [table.points[0][1], table.points[-1][1]]
        if [table.value(0.0), table.value(1.0)] != ends:
            points = [list(point) for point in table.points]
            accepted = "loads from 0 to 1, as the scene has no table [time]"
            raise bad_value(f"table.{number}.points", points, accepted)


def _check_continuation(scene: Scene) -> None:
    """Raise BadInput for a Poisson's ratio with which no material would be more compressible."""
    largest = max(material.nu for material in scene.materials)
    if any(nu >= largest for nu in scene.nu_continuation):
        accepted = f"ratios below {largest:g}, that of the material"
        raise bad_value("nu_continuation", list(scene.nu_continuation), accepted)


def check_radii(scene: Scene) -> None:
    """Raise BadInput for the radius of a probe whose stress is no goal of a run.

    A fit has the goals of its curves.
    """
    goals = scene.accuracy.names if scene.accuracy else []
    for number, probe in enumerate(scene.probe):
        goal = f"{probe.name}.stress"
        if probe.radius is not None and goal not in goals:
            accepted = f"no value, as accuracy.goals does not name '{goal}'"
            raise bad_value(f"probe.{number}.radius", probe.radius, accepted)


def group_references(scene: Scene) -> Iterator[tuple[str, str | int]]:
    """Return the dotted keys of a scene that name physical groups, and the groups."""
    for number, material in enumerate(scene.materials):
        if material.group is not None:
            where = f"material.{number}" if isinstance(scene.material, list) else "material"
            yield f"{where}.group", material.group
    for table in _GROUP_TABLES:
        for number, entry in enumerate(getattr(scene, table)):
            if entry.group is not None:
                yield f"{table}.{number}.group", entry.group
    for kind, features in grouped(scene.features):
        for number, feature in enumerate(features):
            yield from ((f"{kind.key}.{number}.{key}", g) for key, g in feature.named_groups)
    for reaction in scene.reactions:
        yield "reactions", reaction.group
    for group in scene.volumes:
        yield "volumes", group
    for goal in scene.accuracy.names if scene.accuracy else ():
        named = read_goal(goal, scene)
        if named.is_of_group:
            yield "accuracy.goals", named.name


def why_condensed(scene: Scene) -> str:
    """Return why cell pressures cannot be unknowns in a scene; empty if they can."""
    if ELEMENTS[scene.element].volume != "mean":
        names = in_words(e.name for e in ELEMENTS.values() if e.volume == "mean")
        return f"only {names} have cell pressures, not {scene.element}"
    # Terms with a state of their own, or with a matrix that is not assembled, would need two.
    for key in ("time", "nu_continuation"):
        if getattr(scene, key):
            return f"the scene has '{key}'"
    for feature in scene.features:
        if not feature.stateless:
            return f"the scene has '{feature.key}'"
    return ""


def _check_fields(scene: Scene) -> None:
    """Raise BadInput for a field of a feature that the scene does not have."""
    homes: dict[str, list[str]] = {}
    for kind in feature_classes(type(scene)):
        for name in kind.nodal_fields:
            homes.setdefault(name, []).append(kind.key)
    for name in scene.fields:
        if name in homes and not any(getattr(scene, key) for key in homes[name]):
            tables = " and no ".join(f"[[{key}]]" for key in homes[name])
            raise bad_value("fields", name, f"another field, as the scene has no {tables}")
    if scene.fields_at == "nodes" and set(scene.fields) <= set(NODAL):
        accepted = "no value, as 'fields' names none that may be in cells"
        raise bad_value("fields_at", scene.fields_at, accepted)


def _check_plane(scene: Scene) -> None:
    """Raise BadInput for a key of three dimensions in a scene of two."""
    accepted = f"no value, with kinematics = '{scene.kinematics}'"
    for key in _SOLID:
        given = getattr(scene, key)
        if given and not (key == "start" and given.run is not None):
            raise bad_value(key, given if isinstance(given, bool) else "given", accepted)
    for feature in scene.features:
        if not feature.planar:
            raise bad_value(feature.key, "given", accepted)
    if isinstance(scene.mesh, Lattice | Tetrahedra):
        raise bad_value("mesh", type(scene.mesh).__name__.lower(), "a file or a geometry of gmsh")
    components = PLANAR[str(scene.kinematics)].components
    if scene.start and scene.start.map and components == 2:
        x, y, z = scene.start.map
        if x[2] or y[2] or list(z) != [0, 0, 1]:
            rows = [list(row) for row in scene.start.map]
            rule = "a map that leaves z, [[a, b, 0], [c, d, 0], [0, 0, 1]]"
            raise bad_value("start.map", rows, rule)
    for i, move in enumerate(scene.move):
        accepted = f"a motion without z, with kinematics = '{scene.kinematics}'"
        for key, other in (("translate", "rotate"), ("rotate", "translate")):
            alone = move.model_copy(update={other: None})
            # At three points: a rigid displacement is affine.
            u = alone.displacement(np.eye(3) * (1.0, 1.0, 0.0), 0.37)
            if np.abs(u[:, components:]).max(initial=0.0) > 1e-9 * np.abs(u).max():
                axis = f"about {list(move.rotate.axis)}" if move.rotate else ""
                value = axis if key == "rotate" else list(move.translate or ())
                raise bad_value(f"move.{i}.{key}", value, accepted)


def _check_mesh(scene: Scene) -> None:
    if isinstance(scene.mesh, Geometry) and scene.cells is None:
        raise BadInput(f"missing key 'cells': expected a whole number from 1 to {MAX_CELLS}")
    if isinstance(scene.mesh, Lattice | Tetrahedra) and scene.cells is not None:
        key = "cell" if isinstance(scene.mesh, Lattice) else "size"
        raise bad_value("cells", scene.cells, f"no value, as the mesh has its '{key}'")
    if is_shape(scene.mesh):
        if ELEMENTS[scene.element].cell != "tetrahedron":
            accepted = f"one on tetrahedra or triangles, P1, P2, ..., as {scene.mesh.name} has"
            raise bad_value("element", scene.element, accepted)
    elif isinstance(scene.mesh, Path) and scene.cells is not None:
        raise bad_value("cells", scene.cells, f"no value, as {scene.mesh.name} has its own cells")


def _check_time(scene: Scene) -> None:
    """Check the keys of a scene in time, whose materials have a density."""
    if scene.steps != 1:
        raise bad_value("steps", scene.steps, "no value, as [time] has its own 'steps'")
    for key in _QUASI_STATIC:
        if getattr(scene, key):
            raise BadInput(f"'time' and '{key}' exclude each other: expected one of them")
    for material in scene.materials:
        if material.density is None:
            raise BadInput(
                f"missing key 'material.density' of {material.label}: expected a number > 0, "
                "for [time]"
            )


def _check_quasi_static(scene: Scene) -> None:
    """Check that a scene without ``[time]`` has no keys that need it."""
    without = "no value, as the scene has no table [time]"
    for key in ("velocity", "angular_velocity"):
        if (given := getattr(scene.start, key, None)) is not None:
            raise bad_value(f"start.{key}", list(given), without)
    for name in scene.fields:
        if name in IN_TIME:
            raise bad_value("fields", name, "another field, as the scene has no table [time]")
    if scene.start is not None and scene.start.run is None and scene.predictor != "none":
        raise bad_value("predictor", scene.predictor, "'none', as the scene has a 'start'")


def _check_constraints(holds: list[Hold], moves: list[Move]) -> None:
    """Raise BadInput if a group has two conditions on one component."""
    taken = [(str(h.group), set(h.components), "hold") for h in holds]
    for move in moves:
        for group, components, table in taken:
            both = components & set(move.components)
            if group == str(move.group) and both:
                raise BadInput(
                    f"move.group = '{group}': expected components other than "
                    f"{', '.join(sorted(both))}, which [[{table}]] constrains for this group"
                )
        taken.append((str(move.group), set(move.components), "move"))
