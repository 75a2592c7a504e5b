"""The first mesh of a run to an accuracy, whose goals are stresses around points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import scenes
from fem_snh.accuracy.goals import MOST_RADII, sizes_near
from fem_snh.assembly.elements import element
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.mesh.bisection import MOST_CELLS, bisect
from fem_snh.mesh.gmsh_input import MeshData
from fem_snh.mesh.mesh import Mesh, distribute, gather
from fem_snh.mesh.round_faces import round_faces
from fem_snh.mesh.size_field import simplex_volumes
from fem_snh.runs.scene_mesh import make_mesh

Array = npt.NDArray[Any]

#: Rounds of bisection at most, and meshes of a shape, each with cells at the probes that are to be
#: smaller by this factor: the goal then tells which radius they fit.
_MOST_ROUNDS, _MOST_MESHES, _SMALLER = 20, 4, 0.8


def stress_probes(scene: scenes.Scene) -> list[scenes.Probe]:
    """Return the probes around which stresses are goals."""
    named = scene.accuracy.names if scene.accuracy else []
    goals = [scenes.read_goal(name, scene) for name in named]
    names = [goal.name for goal in goals if goal.kind == "stress_at"]
    return [probe for probe in scene.probe if probe.name in names]


def fine_at(
    comm: MPI.Comm,
    scene: scenes.Scene,
    probes: Sequence[scenes.Probe],
    mesh_like: Callable[[MeshData], MeshData] | None = None,
) -> Mesh:
    """Return the mesh of a scene with cells that are small at probes. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    scene : Scene
        The scene of the first level, of triangles or tetrahedra.
    probes : sequence of Probe
        The probes.
    mesh_like : callable, optional
        Meshes the body again, on rank 0, with cells as large as those of another mesh. Default: the
        cells are bisected.
    """
    kinematics = kinematics_of(scene.kinematics)
    mesh = make_mesh(comm, scene, element(scene.element, scene.quadrature, kinematics))
    given = gather(mesh)

    def make_on_root() -> MeshData:
        data, most = given, 1.0
        for _ in range(_MOST_MESHES):
            if (_sizes(data, probes) <= 1).all():
                break
            data = _bisected(given, probes, most)
            if mesh_like:
                data, most = mesh_like(data), _SMALLER * most
        return data

    made = distribute(comm, "the mesh with small cells at probes", make_on_root)
    if mesh_like:
        return made
    # Bisected cells have the faces of the first ones.
    return replace(made, round_faces=round_faces(mesh.domain, kinematics.revolved))


def _bisected(data: MeshData, probes: Sequence[scenes.Probe], most: float) -> MeshData:
    """Return the mesh with cells that are at most so large, over the largest that fits a radius."""
    for _ in range(_MOST_ROUNDS):
        large = _sizes(data, probes) > most
        if not large.any():
            break
        volumes = simplex_volumes(data.x[data.cells[:, : data.x.shape[1] + 1]])
        data = bisect(data, np.where(large, volumes / 2, volumes), MOST_CELLS)
    return data


def _sizes(data: MeshData, probes: Sequence[scenes.Probe]) -> Array:
    """Return the sizes of cells over the largest that fits the radius of a probe near them."""
    dim, sizes = data.x.shape[1], np.zeros(len(data.cells))
    for probe in probes:
        assert probe.radius is not None
        near = sizes_near(data.x[data.cells], np.array(probe.point[:dim]), probe.radius)
        sizes = np.maximum(sizes, near / (MOST_RADII * probe.radius))
    return sizes
