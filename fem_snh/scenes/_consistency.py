"""Checks of a scene's keys against each other, after each of them is valid by itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING

from fem_snh.assembly.elements import ELEMENTS, element
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.contact.obstacle import names as obstacle_names
from fem_snh.errors import BadInput, bad_value, in_words
from fem_snh.files import is_shape
from fem_snh.records.output_fields import IN_TIME, NODAL
from fem_snh.scenes._outputs import Geometry, Lattice, Tetrahedra, read_goal, term_goals
from fem_snh.tables.amplitudes import check_tables
from fem_snh.tables.types import MAX_CELLS
from fem_snh.tables.validation import check_distinct
from fem_snh.terms.feature import feature_classes, grouped

if TYPE_CHECKING:
    from fem_snh.scenes._bones import BoneChoice
    from fem_snh.scenes.schema import Hold, Move, Scene, Symmetry

#: Whether keys contradict each other; then the key, its value, and what is accepted.
Rule = tuple[object, str, object, str]


def check_consistency(scene: Scene) -> None:
    """Raise BadInput for the first contradiction between keys of a scene."""
    element(scene.element, scene.quadrature, kinematics_of(scene.kinematics))
    if isinstance(scene.mesh, Geometry) and scene.cells is None:
        raise BadInput(f"missing key 'cells': expected a whole number from 1 to {MAX_CELLS}")
    _check_rules(_plane_rules(scene) if scene.kinematics else ())
    check_tables(scene.table, dict(scene))
    for kind, features in grouped(scene.features):
        kind.check(features, scene)
    check_distinct("probe.name", [probe.name for probe in scene.probe], "probe")
    names = [*(bone.name for bone in scene.bone), *obstacle_names(scene.obstacle)]
    check_distinct("bone.name", names, "bone and obstacle")
    for rules in (_solver_rules, _field_rules, _mesh_rules, _load_rules, _goal_rules):
        _check_rules(rules(scene))
    _check_rules(_time_rules(scene) if scene.time else _static_rules(scene))
    for material in scene.materials if scene.time else ():
        if material.density is None:
            raise BadInput(
                f"missing key 'material.density' of {material.label}: expected a number > 0, "
                "for [time]"
            )
    _check_constraints(scene.hold, scene.move)


def _check_rules(rules: Iterable[Rule]) -> None:
    """Raise BadInput for the first rule that is a contradiction."""
    for contradicts, key, value, accepted in rules:
        if contradicts:
            raise bad_value(key, value, accepted)


def _plane_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of scenes of two dimensions."""
    kinematics = kinematics_of(scene.kinematics)
    without = f"no value, with kinematics = '{kinematics.name}'"
    yield scene.bone, "bone", "given", without
    yield scene.rig, "rig", "given", without
    for feature in scene.features:
        yield not feature.planar, feature.key, "given", without
    is_solid = isinstance(scene.mesh, Lattice | Tetrahedra)
    yield is_solid, "mesh", type(scene.mesh).__name__.lower(), "a file or a geometry of gmsh"
    if kinematics.components == 3:
        return
    if scene.start and scene.start.map:
        x, y, z = scene.start.map
        rows = [list(row) for row in scene.start.map]
        rule = "a map that leaves z, [[a, b, 0], [c, d, 0], [0, 0, 1]]"
        yield x[2] or y[2] or z != (0, 0, 1), "start.map", rows, rule
    for i, move in enumerate(scene.move):
        in_plane = f"a motion without z, with kinematics = '{kinematics.name}'"
        if move.translate:
            yield move.translate[2], f"move.{i}.translate", list(move.translate), in_plane
        if move.rotate and move.rotate.angle:
            axis = move.rotate.axis
            yield any(axis[:2]), f"move.{i}.rotate", f"about {list(axis)}", in_plane


def _solver_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of how a scene is solved."""
    if scene.predictor == "bones":
        without = "[time]" if scene.time else "no [[bone]]"
        accepted = f"another one, as the scene has {without}"
        yield scene.time or not scene.bone, "predictor", "bones", accepted
    key, why = "static_condensation", condensation_reason(scene)
    if scene.static_condensation:
        has_pressures = ELEMENTS[scene.element].volume == "mean"
        yield not has_pressures, key, "true", f"no value, as {why}"
    yield scene.static_condensation is False and why, key, "false", f"true, as {why}"
    largest, ratios = max(material.nu for material in scene.materials), scene.nu_continuation
    below = f"ratios below {largest:g}, that of the material"
    yield any(nu >= largest for nu in ratios), "nu_continuation", list(ratios), below


def _field_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of output fields and reactions."""
    homes: dict[str, list[str]] = {}
    for kind in feature_classes(type(scene)):
        for name in kind.nodal_fields:
            homes.setdefault(name, []).append(kind.key)
    given = {feature.key for feature in scene.features}
    for name in scene.fields:
        keys = homes.get(name, [])
        tables = " and no ".join(f"[[{key}]]" for key in keys)
        is_absent = keys and given.isdisjoint(keys)
        yield is_absent, "fields", name, f"another field, as the scene has no {tables}"
    accepted = "no value, as 'fields' names none that may be in cells"
    only_nodal = scene.fields_at == "nodes" and set(scene.fields) <= set(NODAL)
    yield only_nodal, "fields_at", scene.fields_at, accepted
    results = term_goals(scene.features)
    accepted = "a group of another name than that of an obstacle or contact"
    for reaction in scene.reactions:  # two columns of one name in steps.csv
        yield f"{reaction.group}.force" in results, "reactions", reaction.group, accepted
    if scene.modes and scene.modes.density:
        is_idle = all(material.density for material in scene.materials)
        accepted = "no value, as each material has its density"
        yield is_idle, "modes.density", scene.modes.density, accepted


def _mesh_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of the mesh, the number of its cells and the element."""
    mesh, cells = scene.mesh, scene.cells
    if isinstance(mesh, Lattice | Tetrahedra):
        key = "cell" if isinstance(mesh, Lattice) else "size"
        yield cells is not None, "cells", cells, f"no value, as the mesh has its '{key}'"
    elif is_shape(mesh):
        accepted = f"one on tetrahedra or triangles, P1, P2, ..., as {mesh.name} has"
        yield ELEMENTS[scene.element].cell != "tetrahedron", "element", scene.element, accepted
    elif isinstance(mesh, Path):
        yield cells is not None, "cells", cells, f"no value, as {mesh.name} has its own cells"


def _load_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of amplitude tables: loads are from 0 to 1 without the table [time]."""
    accepted = "loads from 0 to 1, as the scene has no table [time]"
    for number, table in enumerate(() if scene.time else scene.table):
        ends = [table.points[0][1], table.points[-1][1]]
        points = [list(point) for point in table.points]
        is_cut = [table.value(0.0), table.value(1.0)] != ends
        yield is_cut, f"table.{number}.points", points, accepted


def _goal_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of goals and of the loads at which they are evaluated.

    Stress goals are differentiated by the displacement, which UFL cannot do for the thickness in
    plane stress and the filled fraction of a lattice cell.
    """
    if not (accuracy := scene.accuracy):
        return
    unstressed = kinematics_of(scene.kinematics).plane_stress or isinstance(scene.mesh, Lattice)
    accepted = "another goal than a stress, on a lattice and in plane stress"
    loads: dict[tuple[str, str], object] = {}
    for number, goal in enumerate(accuracy.goals):
        kind, name, _ = read_goal(goal.name, scene)
        is_stress = kind in ("stress", "stress_at")
        yield is_stress and unstressed, "accuracy.goals", goal.name, accepted
        at, key = goal.at, f"accuracy.goals.{number}.at"
        other = loads.setdefault((kind, name), at)
        yield other != at, key, at, f"{other}, as for another component"
        if at is None:
            continue
        if isinstance(at, float):
            steps = scene.time.steps if scene.time else scene.steps
            place, what = at / (scene.duration or 1.0) * steps, "time" if scene.time else "load"
            ends_a_step = 0 < place <= steps and isclose(place, round(place), abs_tol=1e-9)
            yield not ends_a_step, key, at, f"the {what} of one of the {steps} steps"


def _time_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of dynamic scenes."""
    yield scene.steps != 1, "steps", scene.steps, "no value, as [time] has its own 'steps'"


def _static_rules(scene: Scene) -> Iterator[Rule]:
    """Yield the rules of scenes without ``[time]``."""
    if scene.start:
        start = scene.start
        velocities = {"velocity": start.velocity, "angular_velocity": start.angular_velocity}
        for key, given in velocities.items():
            accepted = "no value, as the scene has no table [time]"
            yield given, f"start.{key}", list(given or ()), accepted
        begins = scene.start.run is None and scene.predictor != "none"
        yield begins, "predictor", scene.predictor, "'none', as the scene has a 'start'"
    for name in scene.fields:
        in_time = "another field, as the scene has no table [time]"
        yield name in IN_TIME, "fields", name, in_time


def check_radii(scene: Scene) -> None:
    """Raise BadInput for a probe with a radius if accuracy.goals does not name the probe's stress.

    Fits do not call this: they have the goals of their curves.
    """
    goals = scene.accuracy.names if scene.accuracy else []
    for number, probe in enumerate(scene.probe):
        goal = f"{probe.name}.stress"
        if probe.radius is not None and goal not in goals:
            accepted = f"no value, as accuracy.goals does not name '{goal}'"
            raise bad_value(f"probe.{number}.radius", probe.radius, accepted)


def group_references(scene: Scene) -> Iterator[tuple[str, str | int]]:
    """Yield the dotted keys of a scene that name physical groups, and the groups."""
    for number, material in enumerate(scene.materials):
        if material.group is not None:
            where = f"material.{number}" if isinstance(scene.material, list) else "material"
            yield f"{where}.group", material.group
    tables: dict[str, Sequence[Hold | Move | Symmetry | BoneChoice]] = {
        "hold": scene.hold, "move": scene.move, "symmetry": scene.symmetry, "bone": scene.bone
    }  # fmt: skip
    for table, entries in tables.items():
        for number, entry in enumerate(entries):
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


def condensation_reason(scene: Scene) -> str:
    """Return the reason why cell pressures cannot be unknowns in a scene; "" if they can."""
    if ELEMENTS[scene.element].volume != "mean":
        names = in_words(e.name for e in ELEMENTS.values() if e.volume == "mean")
        return f"only {names} have cell pressures, not {scene.element}"
    # Terms with a state of their own, or with a matrix that is not assembled, would need two.
    for key, given in {"time": scene.time, "nu_continuation": scene.nu_continuation}.items():
        if given:
            return f"the scene has '{key}'"
    for feature in scene.features:
        if not feature.stateless:
            return f"the scene has '{feature.key}'"
    return ""


def _check_constraints(holds: list[Hold], moves: list[Move]) -> None:
    """Raise BadInput if a component of a group is prescribed by two tables."""
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
