"""A scene on coarser meshes, from whose goals an estimate extrapolates."""

from __future__ import annotations

from functools import partial

from fem_snh import scenes
from fem_snh.accuracy.coarser_meshes import CoarserMeshes
from fem_snh.accuracy.no_estimate import NoEstimate
from fem_snh.accuracy.path_errors import Followed, end_of
from fem_snh.errors import BadInput
from fem_snh.runs.exact_bodies import cells_of, is_exact
from fem_snh.runs.goals import scene_goals
from fem_snh.runs.setup import Setup, set_up
from fem_snh.runs.vibrations import vibrations

#: Cells along an edge of the coarser meshes, over those of the run; the fewest of the coarsest one,
#: by the degree: with one cell of degree 2 a quarter turn finds a fifth of its error.
_PARTS, _FEWEST = (0.5, 0.25), {1: 4, 2: 2}


def coarser_meshes(setup: Setup) -> CoarserMeshes:
    """Return coarser meshes of a scene's body.

    Raises
    ------
    NoEstimate
        For a mesh of a file, and with too few cells.
    """
    scene, own = setup.scene, 1.0
    if isinstance(scene.mesh, scenes.Lattice):
        edges = [scene.mesh.cell / part for part in _PARTS]
        label = f"lattices with cells of {edges[0]:g} and {edges[1]:g}"
        others = [
            scene.model_copy(update={"mesh": scene.mesh.model_copy(update={"cell": edge})})
            for edge in edges
        ]
        fineness = list(_PARTS)
    elif is_exact(scene):
        assert scene.cells is not None
        own, cells = float(scene.cells), [cells_of(scene, part * scene.cells) for part in _PARTS]
        fewest = _FEWEST[setup.problem.element.degree]
        if cells[1] < fewest or not cells[1] < cells[0] < own:
            raise NoEstimate(
                f"in place of {scene.cells} cells along an edge coarser meshes would have "
                f"{cells[0]} and {cells[1]}, as the geometry admits: expected two meshes, and "
                f"{fewest} or more"
            )
        label = f"meshes with {cells[0]} and {cells[1]} cells along an edge"
        others = [scene.model_copy(update={"cells": count}) for count in cells]
        fineness = [float(count) for count in cells]
    else:
        raise NoEstimate("the mesh of a file has no coarser one")
    runs = [partial(_follow, setup, other) for other in others]
    return CoarserMeshes((own, fineness[0], fineness[1]), label, runs)


def _follow(setup: Setup, scene: scenes.Scene) -> Followed:
    """Solve a scene and return its goals; see `CoarserMeshes`. Collective."""
    try:
        again = set_up(setup.problem.comm, scene, stiffer=setup.stiffer)
    except BadInput as error:
        raise NoEstimate(f"on a coarser mesh: {error}") from None
    try:
        goals = scene_goals(again, vibrations(again))
        return end_of(again.stepper, again.problem, goals, "on a coarser mesh")
    except BadInput as error:  # cells that are too large for the radius of a probe
        raise NoEstimate(f"on a coarser mesh: {error}") from None
    finally:
        again.destroy()
