"""The bodies of scenes that are known exactly, built in or the shape of a file; their cells."""

from __future__ import annotations

from math import ceil

from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.files import is_shape
from fem_snh.mesh.gmsh_input import has_free_sizes, parameter
from fem_snh.scenes import Geometry, Scene

#: Bodies with plane faces: tetrahedra that are refined in place fill them exactly. So do triangles
#: those whose half plane is a rectangle.
_PLANE_FACES = ("bar", "block", "bracket", "clip", "cook", "cube", "two_blocks")
_RECTANGLES = ("bushing", "cylinder", "tube")
#: Bodies with re-entrant edges.
_REENTRANT = ("bracket", "clip")


def is_exact(scene: Scene) -> bool:
    """Return whether the body is known exactly: cells are made for it, so many along an edge."""
    return scene.cells is not None


def cells_of(scene: Scene, least: float) -> int:
    """Return the fewest cells along an edge that the geometry accepts, at least so many."""
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

    Those change its volume from mesh to mesh, by 2.6 % with 8 cells along a diameter, by 12 % of an
    arm with 12 along it, which no estimate on one mesh sees.
    """
    return _order(scene) == 1 and not has_exact_cells(scene)


def has_curved_cells(scene: Scene) -> bool:
    """Return whether the cells follow round faces. Those of a file's shape do where it has some."""
    return is_shape(scene.mesh) or _order(scene) == 2


def may_have_any_sizes(scene: Scene) -> bool:
    """Return whether the body can be meshed with a field of sizes."""
    if not isinstance(scene.mesh, Geometry):
        return is_shape(scene.mesh)
    return has_free_sizes(scene.mesh.source, kinematics_of(scene.kinematics).dim)


def _order(scene: Scene) -> float:
    """Return the order of the cells of a body that has a choice; else 0."""
    if not isinstance(scene.mesh, Geometry):
        return 0.0
    order = parameter(scene.mesh.source, "order")
    return float(scene.mesh.parameters.get("order", order.default)) if order else 0.0
