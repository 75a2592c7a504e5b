"""The nodes of rigid parts: nodes of groups of the mesh, and nodes in shapes."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.unknowns import numbers_with_ghosts
from fem_snh.errors import bad_value, on_every
from fem_snh.geometry.shapes import Shape, deepest
from fem_snh.mesh.mesh import centroid
from fem_snh.terms.body import Body
from fem_snh.terms.rigid import Rigid

#: Distance from a shape's surface, relative to the body, up to which a node is on it.
_ON_SURFACE = 1e-9


def locate_parts(parts: Sequence[Rigid], body: Body) -> tuple[Array, Array, dict[int, Shape]]:
    """Return the part of each node, the middle of each part, and the parts' shapes. Collective.

    A node in several shapes belongs to the shape in which it is deepest; if it is equally deep, to
    the part whose name sorts first. Nodes of groups belong to no shape.

    Returns
    -------
    numbers : (local nodes,) int
        The number of the node's part; -1 for a node of no part.
    middles : (parts, 3)
        The centroid of a group, or the centre of the bounding box of a shape [m]; 0 along
        directions in which the box is infinite.
    shapes : dict of Shape
        The shapes, by the part's number; parts that are groups are left out.

    Raises
    ------
    BadInput
        On every rank, for a node of two groups, a part without nodes, an infinite shape without the
        key ``about`` or a joint, a shape in a lattice, and a file that cannot be read.
    """
    V, comm = body.V, body.domain.comm
    X = V.tabulate_dof_coordinates()[: _dolfinx.num_nodes(V)[0]]
    middles, depths = np.zeros((len(parts), 3)), np.full((len(parts), len(X)), -inf)
    shapes: dict[int, Shape] = {}
    for i, part in enumerate(parts):
        if part.group is None:
            shapes[i] = solid = _solid(part, body)
            depths[i] = -solid.distance(X)
            middles[i] = np.where(np.isfinite(solid.bounds), solid.bounds, 0.0).mean(axis=0)
            continue
        entities = body.entities("rigid.group", part.group)
        middles[i] = centroid(V.mesh, *entities)
        nodes = _dolfinx.locate_dofs(V, *entities)
        nodes = nodes[nodes < len(X)]
        _check_free(comm, part, parts, (depths[:i, nodes] == inf).any(axis=1))
        depths[i, nodes] = inf
    order = np.argsort([part.label for part in parts])
    chosen = deepest(depths[order], _ON_SURFACE * body.length)
    numbers = np.where(chosen >= 0, order[chosen], -1)
    for i, part in enumerate(parts):
        if not comm.allreduce(int(np.count_nonzero(numbers == i))):
            raise bad_value(part.where, part.label, "a part with nodes of the body")
    return numbers_with_ghosts(V, numbers), middles, shapes


def _solid(part: Rigid, body: Body) -> Shape:
    """Return the shape of a part that has no group. Raises BadInput on every rank. Collective."""
    if body.mesh.skin is not None:
        raise bad_value(part.where, part.label, "a 'group': a lattice has no nodes in shapes")
    solid = on_every(body.domain.comm, part.solid)
    assert solid is not None
    ends = np.isfinite(solid.bounds[:, : body.kinematics.dim]).all()
    if part.about is None and part.joint is None and not ends:
        raise bad_value(part.where, part.label, "'about', a point, with a shape that has no end")
    return solid


def _check_free(comm: MPI.Comm, part: Rigid, parts: Sequence[Rigid], taken: Array) -> None:
    """Raise BadInput on every rank if ``taken``, (earlier parts,) bool, is true on any rank."""
    others = [comm.allreduce(bool(one), op=MPI.LOR) for one in taken]
    if any(others):
        accepted = f"a part without nodes of part {parts[others.index(True)].label!r}"
        raise bad_value("rigid.group", part.label, accepted)
