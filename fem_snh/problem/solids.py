"""The bones and rigid parts of a problem that are shapes: no cell follows their surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import BONES
from fem_snh.assembly.regions import cells_of_one_label
from fem_snh.geometry.shapes import Shape
from fem_snh.problem.problem import Problem

if TYPE_CHECKING:
    from fem_snh.problem.bone_nodes import BoneNodes

Array = npt.NDArray[Any]


class Solid(NamedTuple):
    """A bone or a rigid part that is a shape.

    Attributes
    ----------
    name, kind : str
        Its name, and "bone" or "rigid part".
    shape : Shape
        The shape.
    nodes : (n,) int
        This rank's own nodes in it.
    pose : callable
        Returns the (3, 4) matrix [A | c] of x = A X + c [length] at the problem's state. It is
        collective.
    place : callable
        Lets its nodes be at given points (n, 3) of the solid, by default at their own, and moves
        them there. Collective.
    """

    name: str
    kind: str
    shape: Shape
    nodes: Array
    pose: Callable[[], Array]
    place: Callable[[Array], None]


def solids_in_shapes(problem: Problem) -> list[Solid]:
    """Return the solids of a problem that are shapes."""
    found, owned = [], len(problem.coordinates)
    for number, placed in enumerate(problem.dirichlet.bones):
        if placed.bone.shape is not None:
            name, nodes = placed.bone.name, placed.nodes[placed.nodes < owned]
            pose = partial(_pose_of_bone, problem, placed)
            place = partial(_place_bone, problem, number)
            found.append(Solid(name, "bone", placed.bone.shape, nodes, pose, place))
    if rigid := problem.rigid:
        for number, shape in rigid.shapes.items():
            nodes = rigid.nodes[rigid.labels == number]
            pose = partial(_pose_of_part, problem, number)
            place = partial(_place_part, problem, number)
            found.append(Solid(rigid.names[number], "rigid part", shape, nodes, pose, place))
    return found


def cells_in_shapes(V: _dolfinx.FunctionSpace, bones: Sequence[BoneNodes]) -> Array:
    """Return this rank's own cells whose nodes all are in one bone that is a shape, (n,) int."""
    labels = np.full(sum(_dolfinx.num_nodes(V)), -1)
    for number, bone in enumerate(bones):
        if bone.bone.shape is not None:
            labels[bone.nodes] = number
    return cells_of_one_label(V, labels)


def _pose_of_bone(problem: Problem, placed: Any) -> Array:
    return np.asarray(placed.affine(problem.load))


def _place_bone(problem: Problem, number: int, points: Array) -> None:
    problem.dirichlet.of_label(BONES)[number].points = points
    problem.prescribe(problem.x)


def _pose_of_part(problem: Problem, number: int) -> Array:
    assert problem.rigid is not None
    return np.asarray(problem.rigid.pose(problem.x, number))


def _place_part(problem: Problem, number: int, points: Array) -> None:
    assert problem.rigid is not None
    problem.rigid.place_nodes(problem.x, number, points)
