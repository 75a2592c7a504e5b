r"""Impose the motion of bones and rigid parts on their surfaces, between the nodes of the cells.

A run constrains the nodes in a shape, so that its solid ends at the last of them, up to a cell
below the surface. In the lifted problem the flesh is continued to these nodes, such that it moves
with the solid at the surface (ghost nodes; Mittal & Iaccarino 2005, section 3.2.2). With the
displacement y relative to the solid, in the solid's frame, a node at a depth d along the normal n
has that of its image with the opposite sign,

.. math:: g = -\frac{d}{a} \, y(X + (d + a) n), \qquad a = d,

or of a closer point, if the image is outside of the body or in another solid. Flesh with a large
bulk modulus can do so along the surface alone: the normal component of an inexact continuation
changes its volume.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.differences import SETTLED, Differences, LiftedGoals, largest_components
from fem_snh.accuracy.goal_errors import UNSETTLED, NoEstimate, NoEstimateOnAnyMesh
from fem_snh.accuracy.goals import (
    Goal,
    MeanGoal,
    PointGoal,
    ReactionGoal,
    RigidGoal,
    TermGoal,
    VolumeGoal,
)
from fem_snh.accuracy.lift import nearly_incompressible
from fem_snh.assembly.unknowns import nodes_of_other_cells
from fem_snh.geometry.shapes.triangles import has_edges
from fem_snh.problem.problem import Problem
from fem_snh.problem.solids import Solid, solids_in_shapes
from fem_snh.problem.transfer import LocatedPoints

Array = npt.NDArray[Any]

#: Distances of the second point of a node from the surface, over the node's depth.
_FRACTIONS = (1.0, 0.5, 0.25)
#: lambda/mu up to which the flesh can be continued: nu = 0.495. With 0.4999 the continuation
#: causes pressures, as it is inexact, and changes of forces are 1.9 times too large.
_LARGEST_RATIO = 100.0
#: Depths below this part of the body's size are rounding.
_ON_SURFACE = 1e-9
#: The largest part of the nodes below a surface for which there may be no second point.
_MOST_WITHOUT = 0.25
#: Moves of the nodes below the surfaces at most, each followed by a Newton iteration. A move leaves
#: at most half of what is missing.
_MOST_MOVES = 8
#: Part of the largest error of a vector that remains uncertain of each component.
_OF_VECTOR = 0.05


def check_shapes(problem: Problem) -> None:
    """Raise NoEstimate for shapes with edges, and in flesh that is too incompressible."""
    needed = "it needs a 'group' of the mesh"
    for solid in solids_in_shapes(problem):
        name = f"the {solid.kind} '{solid.name}' is a shape"
        if has_edges(solid.shape):
            raise NoEstimateOnAnyMesh(
                f"{name} with edges, between which and the nodes below them much of the error is: "
                f"{needed}"
            )
        for part in problem.elastic.parts:
            mu, lam = part.region.material.lame
            if not lam <= _LARGEST_RATIO * mu:
                raise NoEstimateOnAnyMesh(
                    f"{name} in flesh with nu = {0.5 / (1 + mu / lam):.5g}, above 0.495: {needed}"
                )


class _Layer(NamedTuple):
    """The nodes below the surface of a solid that belong to cells of the flesh.

    Attributes
    ----------
    solid : Solid
        The solid.
    which : (n,) int
        Which of its nodes they are.
    normals : (n, 3)
        The outward normals at the closest points of the surface.
    depths, heights : (n, 1)
        Their distances from the surface, and those of the second points [length].
    points : (n, 3)
        The second points, at rest [length].
    cells : LocatedPoints
        The cells of these.
    """

    solid: Solid
    which: Array
    normals: Array
    depths: Array
    heights: Array
    points: Array
    cells: LocatedPoints


class ShapeSurfaces:
    """The surfaces of the solids of a lifted problem that are shapes. Collective.

    Parameters
    ----------
    lifted : Problem
        The lifted problem.

    Raises
    ------
    NoEstimate
        If too much of a surface is outside of the body, in another solid, or closer to them than
        its nodes to the surface.
    """

    def __init__(self, lifted: Problem) -> None:
        self._lifted, self._solids = lifted, solids_in_shapes(lifted)
        self._tangential = nearly_incompressible(lifted)
        self._X = lifted.coordinates
        self._offsets = [np.zeros((len(solid.nodes), 3)) for solid in self._solids]
        flesh = self._nodes_of_flesh() if self._solids else np.empty(0, bool)
        self._layers = [self._layer(solid, flesh) for solid in self._solids]

    def __bool__(self) -> bool:
        """Whether there are any surfaces."""
        return bool(self._solids)

    @property
    def below(self) -> bool:
        """Whether nodes lie below the surfaces, not all on them. Collective."""
        return bool(self._lifted.comm.allreduce(sum(len(layer.which) for layer in self._layers)))

    def _nodes_of_flesh(self) -> Array:
        """Return which of this rank's own nodes belong to cells that are assembled. Collective."""
        return nodes_of_other_cells(self._lifted.V, self._lifted.solid_cells)

    def _layer(self, solid: Solid, flesh: Array) -> _Layer:
        comm, domain = self._lifted.comm, self._lifted.domain
        which = np.flatnonzero(flesh[solid.nodes])
        X = self._X[solid.nodes[which]]
        at = solid.shape.evaluate(X)
        normals, depths = at.gradient, np.maximum(-at.distance, 0.0)
        heights = np.zeros_like(depths)
        below = depths > _ON_SURFACE * self._lifted.length
        for fraction in _FRACTIONS:
            points = X + ((1 + fraction) * depths)[:, None] * normals
            outside = np.min([s.shape.distance(points) for s in self._solids], axis=0) > 0
            found = below & (heights == 0) & outside & LocatedPoints(domain, points).inside
            heights[found] = fraction * depths[found]
        kept = heights > 0
        without, total = comm.allreduce(np.array([(below & ~kept).sum(), below.sum()]))
        if without > _MOST_WITHOUT * total:
            raise NoEstimate(
                f"the surface of the {solid.kind} '{solid.name}' is too close to the body's or to "
                "another solid for its cells"
            )
        points = X[kept] + (depths + heights)[kept, None] * normals[kept]
        lengths = depths[kept, None], heights[kept, None]
        cells = LocatedPoints(domain, points)
        return _Layer(solid, which[kept], normals[kept], *lengths, points, cells)

    def update(self) -> None:
        """Move the nodes below the surfaces by half of what they miss. Collective."""
        lifted = self._lifted
        lifted.split(lifted.x)
        changes = []
        for layer, offsets in zip(self._layers, self._offsets, strict=True):
            pose = layer.solid.pose()
            moved = layer.points + lifted.kinematics.padded(layer.cells.values(lifted.u))
            y = np.linalg.solve(pose[:, :3], (moved - pose[:, 3]).T).T - layer.points
            g = offsets[layer.which]
            change = (layer.heights * g + layer.depths * y) / (layer.heights + layer.depths)
            if self._tangential:
                normal = (change * layer.normals).sum(axis=1, keepdims=True)
                change = change - normal * layer.normals
            changes.append(change)
        for layer, offsets, change in zip(self._layers, self._offsets, changes, strict=True):
            offsets[layer.which] -= change
            layer.solid.place(self._X[layer.solid.nodes] + offsets)

    def bind(self, goal: Goal) -> Callable[[], Sequence[float]]:
        """Return the function that evaluates a goal of the lifted problem. Collective.

        A point in a solid moves with it, not with the continuation of the flesh.
        """
        if isinstance(goal, PointGoal):
            point = np.asarray(goal.point)
            depths = [solid.shape.distance(point[None])[0] for solid in self._solids]
            if depths and min(depths) < 0:
                pose = self._solids[int(np.argmin(depths))].pose
                return lambda: goal.components_of(pose() @ [*point, 1.0] - point)
        return goal.bind(self._lifted)


def is_on_flesh(goal: Goal) -> bool:
    """Return whether a goal depends on the flesh outside of solids alone, or on all nodes."""
    if isinstance(goal, MeanGoal):
        return goal.on_surface
    return isinstance(goal, PointGoal | ReactionGoal | RigidGoal | TermGoal | VolumeGoal)


def changes_by_surfaces(
    surfaces: ShapeSurfaces, goals: LiftedGoals, before: Differences
) -> Differences:
    """Return what moving the nodes below the surfaces changes of goals. Collective.

    Parameters
    ----------
    surfaces : ShapeSurfaces
        The surfaces.
    goals : LiftedGoals
        The goals, at the solution of the lifted problem.
    before : Differences
        The errors without these changes.

    Returns
    -------
    Differences
        The changes; what is unsettled of them and of the errors before.

    Raises
    ------
    NoEstimate
        If no equilibrium is found.
    """
    goals.lift.allow(2 * _MOST_MOVES)
    start = last = goals.evaluate()
    moved: Array = np.zeros(len(start))
    for _ in range(_MOST_MOVES if surfaces.below else 0):
        surfaces.update()
        previous, last = last, goals.iterate()
        moved = np.abs(last - previous)  # the further moves are at most a geometric series
        if (moved <= SETTLED * np.abs(before.values + last - start)).all():
            break
    if not np.isfinite(last).all():
        raise NoEstimate("a goal is not finite with the surfaces of shapes")
    change = last - start
    # That of a volume is what the continuation of the flesh misses: no more than a bound.
    inexact = [isinstance(goal, VolumeGoal) for goal in goals.goals for _ in goal.names]
    unsettled = before.unsettled + np.where(inexact, np.abs(change), moved)
    whole = before.values + change
    unsettled = np.maximum(unsettled, _OF_VECTOR * largest_components(goals.goals, whole))
    printed = unsettled > UNSETTLED * np.abs(whole)  # as a bound, of twice the size
    return Differences(change, unsettled + np.where(printed, unsettled + np.abs(whole), 0.0))
