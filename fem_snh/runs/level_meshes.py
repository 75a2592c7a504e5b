"""The levels of a run to an accuracy: the first level's scene, and the meshes of further levels.

A level is a solution on one mesh. The next has smaller cells everywhere, or where the errors are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING, Any, NamedTuple

from mpi4py import MPI

import numpy as np

from fem_snh import scenes
from fem_snh.accuracy.path_errors import HALVES
from fem_snh.accuracy.refinement import Lineage, measured_rates, target_volumes
from fem_snh.arrays import Array
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.choices import DEFAULT_CELLS
from fem_snh.errors import BadInput
from fem_snh.files import is_shape
from fem_snh.kernels.material import material, supports
from fem_snh.mesh.bisection import MOST_CELLS, VertexSizes, bisect_times, simplex_volumes
from fem_snh.mesh.gmsh_input import MeshData, has_free_sizes, parameter
from fem_snh.mesh.mesh import Mesh, distribute, gather, of_input_cells
from fem_snh.mesh.round_faces import round_faces
from fem_snh.mesh.simplices import SIMPLEX_OF, in_simplices
from fem_snh.problem.state_notes import REPLACEMENTS
from fem_snh.runs.progress import Progress
from fem_snh.scenes import Geometry, Lattice, Scene, Tetrahedra
from fem_snh.scenes.build import mesh_with_sizes
from fem_snh.solver.options import OPTIONS

if TYPE_CHECKING:
    from fem_snh.runs.level_runs import Level


class Refined(NamedTuple):
    """What the next level changes.

    Attributes
    ----------
    changes : dict
        Keys of the scene.
    mesh : Mesh or None
        The mesh; None: the scene's own.
    lineage : Lineage or None
        On rank 0, where its cells come from, if those of the last level were bisected.
    """

    changes: dict[str, Any]
    mesh: Mesh | None = None
    lineage: Lineage | None = None


#: Returns `Refined` with cells that are smaller than the last level's by a factor. Collective.
Refine = Callable[[MPI.Comm, Scene, "Level", float], Refined]
#: Returns wanted sizes of cells, from the factor by which their number is to grow.
Target = Callable[[float], Array]
#: A new mesh, and the cell of the last one of which each is a part; None: of several.
Made = tuple[MeshData, Array | None]
#: Bodies with plane faces, which refined tetrahedra fill exactly; and bodies of revolution whose
#: section is a rectangle, which triangles fill exactly.
_PLANE_FACES = ("bar", "block", "bracket", "clip", "cook", "cube", "two_blocks")
_RECTANGLES = ("bushing", "cylinder", "tube")
#: Bodies with re-entrant edges.
_REENTRANT = ("bracket", "clip")
#: Poisson's ratio above which elements with a pointwise volume term are replaced: they lock
#: (docs/results/locking.md).
_LOCKING = 0.4
#: The element of degree 2 on the same cells, by the element of degree 1: it reaches an accuracy of
#: 5 % and less in less time (docs/results/time_to_accuracy.md).
_DEGREE_2 = {"P1": "P2", "Q1": "Q2", "Q1P0": "Q2"}
#: Simplices of degree 2, refined where the errors are, by the element that they replace: in two
#: dimensions, and at re-entrant edges, they reach an accuracy in less time
#: (docs/results/time_to_accuracy.md).
_SIMPLICES = dict.fromkeys(("P1", "Q1", "Q1P0", "Q2", "Q2Q1"), "P2")
#: The replacement of P2P0 on triangles, which takes up to 5 times as long to 0.1 % at a corner.
_PLANE = {"P2P0": "P2P1"}
#: Cells along an edge in the first level over those in the scene: if the element keeps its degree,
#: and if that is raised by one. The first number is also the ratio of time steps.
_FIRST = (0.25, 0.125)
#: Required accuracy from which a coarser mesh is likely to suffice, and the ratios for it.
_COARSE, _FIRST_OF_COARSE = 0.005, (1 / 6, 1 / 12)
#: Fewest cells along an edge of a first level, by the dimension, and fewest time steps.
_FEWEST, _FEWEST_STEPS = {2: 4, 3: 2}, 16
#: The option of Newton's tolerance, and its largest value over the accuracy: the residual is at
#: most a tenth of the accuracy, relative to the acting forces (`fem_snh.choices.ACTING_FORCES`).
_TOLERANCE, _OF_ASKED = "snes_scaled_tol", 1e-4


def is_exact(scene: Scene) -> bool:
    """Return whether the mesh is made for an exact geometry, with ``cells`` along an edge."""
    return scene.cells is not None


def cells_of(scene: Scene, least: float) -> int:
    """Return the smallest number of cells along an edge, >= ``least``, for the geometry."""
    cells = parameter(scene.mesh.source, "cells") if isinstance(scene.mesh, Geometry) else None
    if cells is None:
        return ceil(least)
    return round(cells.step * ceil(max(least, cells.least) / cells.step))


def has_exact_cells(scene: Scene) -> bool:
    """Return whether simplices with straight edges fill the body exactly."""
    exact = _PLANE_FACES + (_RECTANGLES if kinematics_of(scene.kinematics).revolved else ())
    return isinstance(scene.mesh, Geometry) and scene.mesh.source in exact


def has_reentrant_edges(scene: Scene) -> bool:
    """Return whether the body has re-entrant edges."""
    return isinstance(scene.mesh, Geometry) and scene.mesh.source in _REENTRANT


def has_polyhedral_cells(scene: Scene) -> bool:
    """Return whether a body with round faces has cells with straight edges.

    The volume then changes from mesh to mesh: by 2.6 % with 8 cells along a diameter, by 12 % for
    an arm with 12 cells along its length. No estimate on one mesh sees this.
    """
    return _order(scene) == 1 and not has_exact_cells(scene)


def has_curved_cells(scene: Scene) -> bool:
    """Return whether cells follow round faces; the cells of a shape file always do."""
    return is_shape(scene.mesh) or _order(scene) == 2


def may_have_any_sizes(scene: Scene) -> bool:
    """Return whether the body can be meshed with a prescribed field of cell sizes."""
    if not isinstance(scene.mesh, Geometry):
        return is_shape(scene.mesh)
    return has_free_sizes(scene.mesh.source, kinematics_of(scene.kinematics).dim)


def _order(scene: Scene) -> float:
    """Return the geometric order of the cells if the geometry has a parameter for it; else 0."""
    if not isinstance(scene.mesh, Geometry):
        return 0.0
    order = parameter(scene.mesh.source, "order")
    return float(scene.mesh.parameters.get("order", order.default)) if order else 0.0


def first_scene(scene: scenes.Scene, printed: Progress) -> scenes.Scene:
    """Return the scene of the first level: a coarse mesh of an element that does not lock.

    Parameters
    ----------
    scene : Scene
        The scene, whose ``accuracy.within`` is set.
    printed : Progress
        Prints a line for each value that differs from the scene's.
    """
    wanted = scene.accuracy
    assert wanted and wanted.within
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
    goals = [scenes.read_goal(name, scene) for name in wanted.names]
    if any(goal.kind == "stress_at" for goal in goals):
        pass  # cells that fit the radius around the point
    elif is_shape(mesh):
        update["cells"] = min(scene.cells or DEFAULT_CELLS, DEFAULT_CELLS // 2)
    elif is_exact(scene):
        assert scene.cells
        coarse = wanted.within >= _COARSE and _may_raise(scene)
        parts = _FIRST_OF_COARSE if coarse else _FIRST
        fewest = min(scene.cells, _FEWEST[kinematics_of(scene.kinematics).dim])
        update["cells"] = cells_of(scene, max(fewest, parts[raised] * scene.cells))
    given = scene.petsc.get(_TOLERANCE)
    tolerance = float(OPTIONS[_TOLERANCE].default if given is None else given)
    if tolerance > (least := _OF_ASKED * wanted.within):
        printed.line(f"Newton's tolerance is {least:.2g}")
        update["petsc"] = scene.petsc | {_TOLERANCE: least}
    if scene.time:
        steps = HALVES * ceil(max(_FEWEST_STEPS, scene.time.steps / 4) / HALVES)
        update["time"] = scene.time.model_copy(update={"steps": steps})
    return scene.model_copy(update=update)


def coarser_scene(scene: Scene) -> tuple[Scene | None, str]:
    """Return the scene with cells and time steps of twice the size, and which cells these are.

    None, and why, for a mesh of a file, or of so few cells that none is coarser.
    """
    update: dict[str, Any] = {}
    if isinstance(scene.mesh, Lattice):
        cell = 2 * scene.mesh.cell
        update["mesh"], what = scene.mesh.model_copy(update={"cell": cell}), f"cell = {cell:g}"
    elif isinstance(scene.mesh, Tetrahedra):
        size = 2 * scene.mesh.size
        update["mesh"], what = scene.mesh.model_copy(update={"size": size}), f"size = {size:g}"
    elif scene.cells is None:
        return None, "the mesh is that of a file: --accuracy makes finer ones"
    else:
        cells = cells_of(scene, scene.cells / 2)
        if cells >= scene.cells:
            return None, f"no mesh has fewer than {scene.cells} cells along an edge"
        update["cells"], what = cells, f"{cells} cells along an edge"
    if scene.time:
        steps = HALVES * ceil(scene.time.steps / (2 * HALVES))
        update["time"] = scene.time.model_copy(update={"steps": steps})
        what += f", {steps} time steps"
    return scene.model_copy(update=update | {"modes": None, "stability": False}), what


def _element(scene: scenes.Scene) -> tuple[str, str]:
    """Return the element of the levels, and why it is not the scene's; "" if it is."""
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
    """Return the best candidate that fits; else the scene's element, which the run rejects."""
    fitting = (name for name in _candidates(scene, raised) if not _misfit(scene, name))
    return next(fitting, scene.element)


def _candidates(scene: scenes.Scene, raised: Mapping[str, str]) -> list[str]:
    """Return candidate elements, the best first, the scene's own last.

    A continuous pressure is wrong at the interface of materials: with several materials, elements
    that have one are left out. ``raised`` has elements of degree 2 by the element they replace.
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
    """Return whether larger cells of degree 2 may be used: they have to fill the same body.

    With contact in a static scene the solution is less smooth than cells of degree 2 need. In a
    dynamic scene they need fewer dofs even for an impact (docs/results/time_to_accuracy.md).
    """
    assert scene.accuracy
    if scene.accuracy.keep_element or not is_exact(scene):
        return False
    if not scene.time and (scene.obstacle or scene.contact or scene.self_contact):
        return False
    return has_exact_cells(scene) or has_curved_cells(scene)


def _may_be_simplices(scene: scenes.Scene) -> bool:
    """Return whether simplices may replace other cells.

    In three dimensions P2P0, which does not lock, takes more time than Q2Q1. With several nearly
    incompressible materials P2P0 is the only choice.
    """
    if not has_exact_cells(scene):
        return False
    if kinematics_of(scene.kinematics).dim == 2:
        return not (_locks(scene) and len(scene.materials) > 1)
    return has_reentrant_edges(scene) and not _locks(scene)


def _misfit(scene: scenes.Scene, element: str) -> str:
    """Return why the scene's features and materials do not support an element; "" if they do."""
    try:
        scenes.check_consistency(scene.model_copy(update={"element": element}))
    except BadInput as error:
        return str(error)
    volume = ELEMENTS[element].volume
    for chosen in () if volume == "pointwise" else scene.materials:
        made = material(chosen.name, chosen.E, chosen.nu, **chosen.parameters)
        if not supports(made, volume):
            return f"the material '{chosen.name}' does not support element = '{element}'"
    return ""


def _has_simplices(scene: Scene) -> bool:
    """Return whether the cells are tetrahedra or triangles."""
    return ELEMENTS[scene.element].cell == "tetrahedron"


def refinement_of(scene: Scene) -> Refine:
    """Return the function that refines the mesh of a scene.

    Hexahedra and quadrilaterals of a file become simplices first.
    """
    has_simplices = _has_simplices(scene)
    if isinstance(scene.mesh, Lattice):
        return smaller_lattice
    if is_exact(scene) and not (has_simplices and has_exact_cells(scene)):
        # On a path the errors are not distributed to the cells.
        sizes = has_simplices and not scene.time and may_have_any_sizes(scene)
        return meshed_again if sizes else more_cells
    return bisected


def is_refined_locally(scene: Scene) -> bool:
    """Return whether a scene's mesh is refined where the errors are."""
    return refinement_of(scene) in (bisected, meshed_again)


def more_cells(comm: MPI.Comm, scene: Scene, last: Level, finer: float) -> Refined:
    """Return a `Refined` scene with more cells along an edge."""
    assert scene.cells is not None
    return Refined({"cells": cells_of(scene, max(scene.cells + 1, scene.cells * finer))})


def smaller_lattice(comm: MPI.Comm, scene: Scene, last: Level, finer: float) -> Refined:
    """Return a `Refined` scene with a smaller cell of the lattice."""
    assert isinstance(scene.mesh, Lattice)
    return Refined({"cell": scene.mesh.cell / finer})


def bisected(comm: MPI.Comm, scene: Scene, last: Level, finer: float) -> Refined:
    """Return `Refined` with cells bisected where the errors are.

    Other cells become simplices, which are bisected if their degree is not higher.

    Raises
    ------
    BadInput
        If they cannot become simplices.
    """
    changes: dict[str, Any] = {}
    if not _has_simplices(scene):
        assert scene.accuracy
        element = _fitting(scene, {} if scene.accuracy.keep_element else _SIMPLICES)
        if ELEMENTS[element].cell != "tetrahedron":
            keeps = scene.accuracy.keep_element
            why = "keep_element is true" if keeps else _misfit(scene, _SIMPLICES[scene.element])
            raise BadInput(f"cells of a file are refined as simplices, and {why}")
        finer = 1.0 if ELEMENTS[element].degree > ELEMENTS[scene.element].degree else finer
        changes["element"] = element

    def bisect(data: MeshData, sizes: VertexSizes, target: Target, wanted: float) -> Made:
        def at_corners(growth: float) -> Array:
            return sizes.at_corners(target(growth))

        if wanted == 1:
            return data, None
        return bisect_times(data, at_corners, wanted, MOST_CELLS)

    mesh, lineage = _with_target(comm, scene, last, finer, bisect)
    assert last.mesh is not None
    revolved = kinematics_of(scene.kinematics).revolved
    faces = last.mesh.round_faces or round_faces(last.mesh.domain, revolved)
    return Refined(changes, replace(mesh, round_faces=faces), lineage)


def meshed_again(comm: MPI.Comm, scene: Scene, last: Level, finer: float) -> Refined:
    """Return `Refined` with a new mesh of the exact body, its cell sizes from the errors."""

    def mesh(data: MeshData, sizes: VertexSizes, target: Target, wanted: float) -> Made:
        return mesh_with_sizes(scene, data.cell, sizes.field(target(wanted))), None

    return Refined({}, *_with_target(comm, scene, last, finer, mesh))


def _with_target(
    comm: MPI.Comm,
    scene: Scene,
    last: Level,
    finer: float,
    make: Callable[[MeshData, VertexSizes, Target, float], Made],
) -> tuple[Mesh, Lineage | None]:
    """Return the next mesh, distributed, and on rank 0 where its cells come from. Collective.

    Rank 0 calls ``make`` with the last mesh, sizes at its vertices, a `Target` and the growth of
    the number of cells.
    """
    assert last.mesh is not None and last.row is not None
    data, indicators = gather(last.mesh), last.row.estimate.indicators
    known = last.volumes, last.cell_weights(), last.cell_weights(True), *indicators.values()
    table = of_input_cells(last.mesh.domain, np.column_stack(known)).T
    degree, dim = ELEMENTS[scene.element].degree, last.mesh.dim
    left = last.levels.left_of_errors if last.lineage else 0.0
    left = comm.bcast(left)

    lineage: Lineage | None = None

    def make_on_root() -> MeshData:
        nonlocal lineage
        volumes, errors, every = table[:3]
        mesh, roots = in_simplices(data) if data.cell in SIMPLEX_OF else (data, None)
        if roots is not None:
            volumes = simplex_volumes(mesh.x[mesh.cells[:, : dim + 1]])
            errors, every = (x[roots] / np.bincount(roots)[roots] for x in (errors, every))
        rates = measured_rates(every, last.lineage, degree, dim)
        sizes = VertexSizes(mesh.cells[:, : dim + 1], mesh.x)

        def target(growth: float) -> Array:
            return target_volumes(
                volumes, errors, rates, degree, dim, growth * len(volumes),
                sizes.expected, left if growth <= finer**dim else 0.0,
            )  # fmt: skip

        made, parents = make(mesh, sizes, target, finer**dim)
        if parents is not None and mesh is data:
            of_goals = dict(zip(indicators, np.abs(table[3:]), strict=True))
            lineage = Lineage(parents, every, rates, of_goals)
        return made

    return distribute(comm, "the refined mesh", make_on_root), lineage
