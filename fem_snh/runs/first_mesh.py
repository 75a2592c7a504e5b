"""The first mesh of a run to an accuracy, whose goals are stresses around points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import scenes
from fem_snh.accuracy.probe_cells import MOST_RADII, sizes_near
from fem_snh.assembly.elements import element
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.mesh import simplices
from fem_snh.mesh.gmsh_input import MeshData
from fem_snh.mesh.mesh import Mesh, distribute, gather
from fem_snh.mesh.round_faces import round_faces
from fem_snh.runs.scene_mesh import make_mesh

Array = npt.NDArray[Any]

#: Times that cells are made smaller at most; the goal then tells which radius they fit.
_MOST_TIMES = 8


def stress_probes(scene: scenes.Scene) -> list[scenes.Probe]:
    """Return the probes around which stresses are goals."""
    named = scene.accuracy.goals if scene.accuracy else []
    goals = [scenes.read_goal(name, scene) for name in named]
    names = [goal.name for goal in goals if goal.kind == "stress_at"]
    return [probe for probe in scene.probe if probe.name in names]


def fine_at(
    comm: MPI.Comm,
    scene: scenes.Scene,
    probes: Sequence[scenes.Probe],
    smaller: Callable[[MeshData, Array], MeshData],
) -> Mesh:
    """Return the mesh of a scene with cells that are small at probes. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    scene : Scene
        The scene of the first level.
    probes : sequence of Probe
        The probes.
    smaller : callable
        Returns, on rank 0, a mesh of triangles or tetrahedra with cells of other volumes.
    """
    kinematics = kinematics_of(scene.kinematics)
    mesh = make_mesh(comm, scene, element(scene.element, scene.quadrature, kinematics))
    given = gather(mesh)

    def make_on_root() -> MeshData:
        data = given
        for _ in range(_MOST_TIMES):
            corners = data.x[data.cells[:, : data.x.shape[1] + 1]]
            volumes = simplices.volumes(corners)
            parts = np.ones(len(volumes))
            for probe in probes:
                assert probe.radius is not None
                point = np.asarray(probe.point, dtype=float)[: data.x.shape[1]]
                sizes = sizes_near(data.x[data.cells], point, probe.radius)
                parts = np.maximum(parts, sizes / (MOST_RADII * probe.radius))
            if not (large := parts > 1).any():
                break
            # Cells of a certain volume have different shapes, and hardly smaller ones none is made.
            parts[large] = 2.0 * parts[large] ** data.x.shape[1]
            data = smaller(data, volumes / parts)
        return data

    made = distribute(comm, "the mesh with small cells at probes", make_on_root)
    return replace(made, round_faces=round_faces(mesh.domain, kinematics.revolved))
