"""The scene of the first level of a run to an accuracy: its element, mesh and time steps."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import Any

from fem_snh import scenes
from fem_snh.accuracy.path_errors import HALVES
from fem_snh.accuracy.state_notes import REPLACEMENTS
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.choices import DEFAULT_CELLS
from fem_snh.errors import BadInput
from fem_snh.files import is_shape
from fem_snh.kernels.compiled import supports
from fem_snh.kernels.material import material
from fem_snh.runs.exact_bodies import (
    cells_of,
    has_curved_cells,
    has_exact_cells,
    has_polyhedral_cells,
    has_reentrant_edges,
    is_exact,
)
from fem_snh.runs.progress import Progress

#: Poisson's ratio above which elements with a pointwise volume term are replaced: they lock
#: (docs/results/locking.md).
_LOCKING = 0.4
#: Elements of degree 2 on the cells of those of degree 1: at 5 % and less they reach an accuracy in
#: less time (docs/results/time_to_accuracy.md).
_DEGREE_2 = {"P1": "P2", "Q1": "Q2", "Q1P0": "Q2"}
#: Simplices of degree 2, which are refined where the error is, in place of other cells: in two
#: dimensions, and at re-entrant edges, they reach an accuracy in less time
#: (docs/results/time_to_accuracy.md).
_SIMPLICES = dict.fromkeys(("P1", "Q1", "Q1P0", "Q2", "Q2Q1"), "P2")
#: In place of P2P0 on triangles, which takes up to five times as long to 0.1 % at a corner.
_PLANE = {"P2P0": "P2P1"}
#: Cells of the first level over those of the scene, along an edge, by the degree by which the
#: element is raised; likewise time steps.
_FIRST = (0.5, 0.25)
#: The same for accuracies of this and more, for which a coarser mesh is likely to do.
_COARSE, _FIRST_OF_COARSE = 0.005, (1 / 3, 1 / 6)
#: Fewest cells along an edge of a first level, and fewest time steps.
_FEWEST, _FEWEST_STEPS = 3, 16


def first_scene(scene: scenes.Scene, printed: Progress) -> scenes.Scene:
    """Return the scene of the first level: a coarse mesh of an element that does not lock.

    Parameters
    ----------
    scene : Scene
        The scene, whose ``accuracy.within`` is set.
    printed : Progress
        Prints a line for each choice that is not the scene's.
    """
    update: dict[str, Any] = {}
    mesh = scene.mesh
    if isinstance(mesh, scenes.Geometry) and has_polyhedral_cells(scene):
        printed.line("order = 2 in place of 1: cells with curved faces, as the body is round")
        parameters = {**mesh.parameters, "order": 2}
        update["mesh"] = mesh.model_copy(update={"parameters": parameters})
    scene = scene.model_copy(update=update)
    element, reason = _element(scene)
    if reason:
        printed.line(f"element = '{element}' in place of '{scene.element}', {reason}")
    raised = ELEMENTS[element].degree - ELEMENTS[scene.element].degree
    update = {"element": element}
    if is_shape(mesh):
        update["cells"] = min(scene.cells or DEFAULT_CELLS, DEFAULT_CELLS)
    elif is_exact(scene):
        assert scene.accuracy and scene.accuracy.within and scene.cells
        coarse = scene.accuracy.within >= _COARSE and _may_raise(scene)
        parts = _FIRST_OF_COARSE if coarse else _FIRST
        fewest = max(min(scene.cells, _FEWEST), parts[raised] * scene.cells)
        update["cells"] = cells_of(scene, fewest)
    if scene.time:
        steps = HALVES * ceil(max(_FEWEST_STEPS, _FIRST[0] * scene.time.steps) / HALVES)
        update["time"] = scene.time.model_copy(update={"steps": steps})
    return scene.model_copy(update=update)


def raised_element(scene: scenes.Scene) -> str:
    """Return the element of degree 2 on the cells of a scene that does not lock; else its own."""
    return _fitting(scene, _DEGREE_2)


def _element(scene: scenes.Scene) -> tuple[str, str]:
    """Return the element of the levels, and why it is not the scene's; empty if it is."""
    own = scene.element
    ways: list[Mapping[str, str]] = [_DEGREE_2] if _may_raise(scene) else [{}]
    if _may_raise(scene) and _may_be_simplices(scene):
        ways.insert(0, _SIMPLICES)
    for raised in ways:
        fitting = _fitting(scene, raised)
        if not (_locks(scene) and ELEMENTS[fitting].volume == "pointwise"):
            break
    if fitting == own:
        return own, ""
    if _locks(scene) and ELEMENTS[own].volume == "pointwise":
        return fitting, "which locks"
    if own in _PLANE:
        return fitting, "which takes longer to the same accuracy"
    same = ELEMENTS[own].degree == ELEMENTS[fitting].degree
    return fitting, "whose cells are refined everywhere" if same else "which needs more dofs"


def _fitting(scene: scenes.Scene, raised: Mapping[str, str]) -> str:
    """Return the best candidate that fits; the scene's own if none does, which the run rejects."""
    return next((n for n in _candidates(scene, raised) if _fits(scene, n)), scene.element)


def _candidates(scene: scenes.Scene, raised: Mapping[str, str]) -> list[str]:
    """Return elements of a scene, the best first, the last its own.

    A continuous pressure is wrong at the interface of several materials: none is chosen there.
    """
    own, several = scene.element, len(scene.materials) > 1
    other = raised.get(own, own)
    if not _locks(scene):
        return [other, own]
    plane = _PLANE if kinematics_of(scene.kinematics).dim == 2 else {}
    without = REPLACEMENTS.get(other, other)
    names = [plane.get(without, without), without, REPLACEMENTS.get(own, own), other]
    chosen = [n for n in names if not several or ELEMENTS[n].volume == "mean"]
    return [*chosen, own]


def _locks(scene: scenes.Scene) -> bool:
    """Return whether an element with a pointwise volume term locks."""
    sheet = kinematics_of(scene.kinematics).plane_stress
    return not sheet and max(material.nu for material in scene.materials) > _LOCKING


def _may_raise(scene: scenes.Scene) -> bool:
    """Return whether larger cells of degree 2 are the same body.

    With contact in a static scene the solution is less smooth than cells of degree 2 need. In time
    they need fewer dofs also for an impact (docs/results/time_to_accuracy.md).
    """
    assert scene.accuracy
    if scene.accuracy.keep_element or not is_exact(scene):
        return False
    if not scene.time and (scene.obstacle or scene.contact or scene.self_contact):
        return False
    return has_exact_cells(scene) or has_curved_cells(scene)


def _may_be_simplices(scene: scenes.Scene) -> bool:
    """Return whether simplices may replace other cells.

    In three dimensions P2P0, which does not lock, takes more time than Q2Q1. Several nearly
    incompressible materials have P2P0 alone.
    """
    if not has_exact_cells(scene):
        return False
    if kinematics_of(scene.kinematics).dim == 2:
        return not (_locks(scene) and len(scene.materials) > 1)
    return has_reentrant_edges(scene) and not _locks(scene)


def _fits(scene: scenes.Scene, element: str) -> bool:
    """Return whether the scene's features and materials have an element."""
    try:
        scenes.check_consistency(scene.model_copy(update={"element": element}))
    except BadInput:
        return False
    volume = ELEMENTS[element].volume
    return volume == "pointwise" or all(
        supports(material(chosen.name, chosen.E, chosen.nu, **chosen.parameters), volume)
        for chosen in scene.materials
    )
