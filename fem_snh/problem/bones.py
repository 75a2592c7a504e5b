"""Bones: the nodes of a mesh that lie in them, their motion, and their forces on the body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import group_nodes
from fem_snh.assembly.unknowns import numbers_with_ghosts, summed_over_ranks
from fem_snh.errors import BadInput, bad_value
from fem_snh.geometry.motions import Bone, check_determinant
from fem_snh.geometry.shapes import ClosedSurface, Shape, deepest
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.initial_state import bounding_box
from fem_snh.problem.problem import Problem

#: Depths that differ by less than this part of the body's extent are equal: coordinates differ by
#: rounding between partitions, and the choice of a node's bone must not.
_ROUNDING = 1e-9


class BoneNodes:
    """A bone with the nodes that follow it. Collective.

    Parameters
    ----------
    bone : Bone
        The bone.
    comm : MPI.Intracomm
        The communicator of the mesh.
    nodes : (n,) int array
        The bone's local nodes, ghosts included.
    X : (k, 3) array
        Reference coordinates [length] of the k of these nodes that this rank owns.

    Attributes
    ----------
    count : int
        Number of the bone's nodes on all ranks.
    centre : (3,) array
        Centre of the bounding box of the bone's nodes [length].
    length : float
        Twice the largest distance of one of these nodes from the centre [length].

    Raises
    ------
    BadInput
        On every rank, if noise makes the bone's affine map singular at a load.
    """

    def __init__(self, bone: Bone, comm: MPI.Intracomm, nodes: Array, X: Array) -> None:
        self.bone, self.nodes = bone, nodes
        self.count = int(comm.allreduce(len(X)))
        low, high = bounding_box(comm, X)
        self.centre: Array = (low + high) / 2
        reach = float(np.linalg.norm(X - self.centre, axis=1).max(initial=0.0))
        self.length = 2 * float(comm.allreduce(reach, op=MPI.MAX))
        self._noise: Callable[[float], Array] | None = None
        if bone.noise is not None and bone.noise.amplitude:
            self._noise = bone.noise.motion(bone.name, self.centre, self.length)
            for load in np.linspace(0.0, 1.0, bone.noise.frames + 1):
                check_determinant(
                    f"bone '{bone.name}' with noise at load {load:g}", self.affine(load)
                )

    @property
    def origin(self) -> Array:
        """The reference point (3,) [length] whose present position the moment is about."""
        return self.centre if self.bone.origin is None else np.asarray(self.bone.origin)

    @property
    def moves(self) -> bool:
        """Whether the bone moves."""
        return self.bone.motion is not None or self._noise is not None

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] of the map x = A X + c [length] at a load, 0 to 1."""
        matrix = self.bone.affine(load)
        return matrix if self._noise is None else matrix + self._noise(load)

    def displacement(self, X: Array, load: float) -> Array:
        """Return the (n, 3) displacement [length] of reference points X (n, 3) at a load."""
        matrix = self.affine(load)
        u: Array = X @ matrix[:, :3].T + matrix[:, 3] - X
        return u


def place_bones(
    V: _dolfinx.FunctionSpace, mesh: Mesh | None, bones: Sequence[Bone]
) -> list[BoneNodes]:
    """Return each bone with its nodes: those on or below its surface. Collective.

    A node in several bones follows the bone in which it is deepest (smallest signed distance). A
    group of the mesh precedes all shapes; between bones of equal depth the first by name is taken.
    A shape holds no `NodeCopies` of a lattice: their part of the body is elsewhere.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh or None
        The mesh with its groups; without one, all bones must have shapes.
    bones : sequence of Bone
        The bones, in any order, with different names.

    Raises
    ------
    BadInput
        On every rank, for an unknown group, a group that is no volume, a bone without a node, and
        bones that hold all nodes of the body.
    """
    comm, owned = V.mesh.comm, _dolfinx.num_nodes(V)[0]
    X = V.tabulate_dof_coordinates()
    low, high = bounding_box(comm, X)
    tolerance = _ROUNDING * float(np.linalg.norm(high - low))
    order = sorted(bones, key=lambda bone: bone.name)
    copies = _copies(V, mesh)
    depths = np.stack([_depths(V, mesh, bone, X[:owned], copies) for bone in order])
    number = deepest(depths, tolerance)
    if bones and not comm.allreduce(int(np.count_nonzero(number < 0))):
        raise BadInput(f"bone: {_listed(order)} hold all nodes of the body: expected a free node")
    local = numbers_with_ghosts(V, number)
    found = {}
    for i, bone in enumerate(order):
        if not comm.allreduce(int(np.count_nonzero(number == i))):
            raise BadInput(_reason(bone, comm, depths[i], tolerance))
        nodes = np.flatnonzero(local == i)
        found[bone.name] = BoneNodes(bone, comm, nodes, X[nodes[nodes < owned]])
    return [found[bone.name] for bone in bones]


def _listed(bones: Sequence[Bone]) -> str:
    """Return the names of bones as text."""
    return ", ".join(f"'{bone.name}'" for bone in bones)


def _copies(V: _dolfinx.FunctionSpace, mesh: Mesh | None) -> Array:
    """Return which owned nodes are `NodeCopies` of the mesh, (owned nodes,) bool. Collective."""
    owned = _dolfinx.num_nodes(V)[0]
    if mesh is None or mesh.copies is None or not len(mesh.copies.cells):
        return np.zeros(owned, bool)
    nodes, copies = _dolfinx.node_dofs(V), mesh.copies
    row_of = np.full(mesh.num_cells, -1)
    row_of[copies.cells] = np.arange(len(copies.cells))
    row = row_of[_dolfinx.input_cells(V.mesh)[: len(nodes)]]
    xi = _dolfinx.reference_nodes("hexahedron", _dolfinx.degree(V))
    columns = np.round(2 * xi).astype(int) @ [9, 3, 1]
    chosen = row >= 0
    values = np.zeros((sum(_dolfinx.num_nodes(V)), 3))
    # All cells that share a node give the same value.
    values[nodes[chosen].ravel(), 0] = copies.copied[row[chosen]][:, columns].ravel()
    return np.asarray(summed_over_ranks(V, values)[:owned, 0] > 0)


def _depths(
    V: _dolfinx.FunctionSpace, mesh: Mesh | None, bone: Bone, X: Array, copies: Array
) -> Array:
    """Return the depths (n,) [length] of the owned nodes, at X (n, 3), in a bone.

    Outside they are negative; inf in and -inf outside of a group; -inf for ``copies``.
    """
    if bone.shape is not None:
        return np.asarray(np.where(copies, -np.inf, _depths_in(bone.shape, X)))
    if mesh is None or bone.group is None:
        raise bad_value("bone.group", bone.group, "no value, as the mesh has no groups")
    group = mesh.group(bone.group)
    if group.dim != 3:
        raise bad_value("bone.group", bone.group, f"a group of volumes, not a {group.label}")
    depths: Array = np.full(len(X), -np.inf)
    nodes = group_nodes(V, mesh, bone.group)
    depths[nodes[nodes < len(X)]] = np.inf
    return depths


def _depths_in(shape: Shape, X: Array) -> Array:
    """Return the depths (n,) [length] of points X (n, 3) in a shape, negative outside."""
    if not isinstance(shape, ClosedSurface):
        return -shape.distance(X)
    # The distance costs 10 us a point; the distance from the bounding box is a lower bound.
    low, high = shape.bounds
    depths: Array = -np.linalg.norm(np.maximum(0.0, np.maximum(low - X, X - high)), axis=1)
    near = np.flatnonzero(depths > -_ROUNDING * shape.diagonal)
    depths[near] = -shape.distance(X[near])
    return depths


def _reason(bone: Bone, comm: MPI.Intracomm, depths: Array, tolerance: float) -> str:
    """Return the message for a bone without a node. Collective."""
    deepest = comm.allreduce(float(depths.max(initial=-np.inf)), op=MPI.MAX)
    if deepest >= -tolerance:
        return (
            f"bone '{bone.name}': all of its nodes are deeper in other bones: expected a bone "
            "with nodes of its own"
        )
    return (
        f"bone '{bone.name}': expected a bone that holds a node of the mesh: the closest one is "
        f"{-deepest:.3g} away"
    )


#: Exponent of the distances. Above 3, many far bones do not outweigh a near one; 2 to 4 cost the
#: same iterations in an arm of two bones.
_POWER = 4.0


class BoneBlend:
    r"""The weighted mean of the bones' motions at each node. Collective.

    From load s to load e, a node moves from x to

    .. math:: \sum_b w_b A_b(e) A_b(s)^{-1} x, \quad
              w_b = \frac{d_b^{-4}}{\sum_c d_c^{-4}},

    where d_b is the distance of the node's reference position from the closest node of bone b
    (linear blend skinning with the weights of Shepard 1968). It is exact if all bones have the same
    motion.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    bones : sequence of BoneNodes
        The bones.
    """

    def __init__(self, V: _dolfinx.FunctionSpace, bones: Sequence[BoneNodes]) -> None:
        from scipy.spatial import cKDTree  # slow to import

        self._bones, comm = list(bones), V.mesh.comm
        owned = _dolfinx.num_nodes(V)[0]
        self._X: Array = V.tabulate_dof_coordinates()[:owned]
        weights = np.empty((len(bones), owned))
        for row, bone in zip(weights, bones, strict=True):
            nodes = self._X[bone.nodes[bone.nodes < owned]]
            distance = cKDTree(np.concatenate(comm.allgather(nodes))).query(self._X)[0]
            row[:] = distance
        # Relative to the closest bone's distance (0 for nodes in bones) no power overflows.
        closest = np.maximum(weights.min(axis=0), np.finfo(float).tiny)
        weights = np.maximum(weights / closest, 1.0) ** -_POWER
        self._weights = weights / weights.sum(axis=0)

    def move(self, x: PETSc.Vec, start: float, end: float) -> None:
        """Move the displacement in ``x``, its first entries, from load ``start`` to ``end``."""
        X = self._X
        u = x.array[: X.size].reshape(-1, 3)
        position, moved = X + u, -X
        for bone, weight in zip(self._bones, self._weights, strict=True):
            before, after = bone.affine(start), bone.affine(end)
            rest = np.linalg.solve(before[:, :3], (position - before[:, 3]).T)
            moved += weight[:, None] * (after[:, :3] @ rest + after[:, 3:]).T
        u[:] = moved


class BoneRecords:
    """Forces and moments that the bones exert on the body.

    Parameters
    ----------
    problem : Problem
        A problem with bones.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._bones: list[BoneNodes] = problem.dirichlet.bones

    def blend(self) -> Callable[[PETSc.Vec, float, float], None]:
        """Return ``move(x, start, end)`` of a `BoneBlend` of the bones. Collective."""
        return BoneBlend(self._problem.V, self._bones).move

    def row(self) -> dict[str, dict[str, Any]]:
        """Return what run.json has of each bone at the present state, by name. Collective.

        Returns
        -------
        dict
            ``force`` [N], the sum of dE/du over the bone's nodes; ``moment`` [N m] of these forces
            about ``origin``, the present position [length] of the bone's origin; ``nodes``, the
            number of the bone's nodes; ``pose``, the three rows [A | c].
        """
        problem, X = self._problem, self._problem.coordinates
        f = problem.nodal(problem.gradient_at(problem.x))
        x = X + problem.nodal(problem.x)
        poses = [bone.affine(problem.load) for bone in self._bones]
        origins = [p[:, :3] @ b.origin + p[:, 3] for p, b in zip(poses, self._bones, strict=True)]
        local = np.zeros((len(self._bones), 2, 3))
        for sums, bone, origin in zip(local, self._bones, origins, strict=True):
            nodes = bone.nodes[bone.nodes < len(X)]
            sums[0] = f[nodes].sum(axis=0)
            sums[1] = np.cross(x[nodes] - origin, f[nodes]).sum(axis=0)
        total = problem.comm.allreduce(local)
        return {
            bone.bone.name: {
                "force": total[i, 0].tolist(),
                "moment": total[i, 1].tolist(),
                "origin": origins[i].tolist(),
                "nodes": bone.count,
                "pose": poses[i].tolist(),
            }
            for i, bone in enumerate(self._bones)
        }
