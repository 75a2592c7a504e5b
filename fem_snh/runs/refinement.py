"""The finer mesh of a run's next level: smaller cells everywhere, or where the errors are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.accuracy.target_volumes import target_volumes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.mesh.bisection import MOST_CELLS, bisect_times
from fem_snh.mesh.gmsh_input import MeshData
from fem_snh.mesh.mesh import Mesh, distribute, gather
from fem_snh.mesh.round_faces import round_faces
from fem_snh.mesh.size_field import simplex_volumes, size_field
from fem_snh.runs.exact_bodies import cells_of, has_exact_cells, is_exact, may_have_any_sizes
from fem_snh.runs.first_level import raised_element
from fem_snh.runs.scene_mesh import mesh_again
from fem_snh.scenes import Lattice, Scene

if TYPE_CHECKING:
    from fem_snh.runs.levels import Level

Array = npt.NDArray[Any]

#: Returns the scene of the next level, and its mesh if that is not the scene's own, for cells that
#: are smaller than those of the last level by a factor. Collective.
Refine = Callable[[MPI.Comm, Scene, "Level", float], tuple[Scene, Mesh | None]]
#: The volumes of cells that a level wants, by the factor of the number of cells.
Target = Callable[[float], Array]


def refinement_of(scene: Scene) -> Refine:
    """Return how the mesh of a scene is refined; hexahedra of a file get a higher degree."""
    has_simplices = ELEMENTS[scene.element].cell == "tetrahedron"
    if isinstance(scene.mesh, Lattice):
        return smaller_lattice
    if is_exact(scene) and not (has_simplices and has_exact_cells(scene)):
        # On a path the errors are not distributed to the cells.
        sizes = has_simplices and not scene.time and may_have_any_sizes(scene)
        return meshed_again if sizes else more_cells
    return bisected if has_simplices else higher_degree


def is_refined_locally(scene: Scene) -> bool:
    """Return whether a scene's mesh is refined where the errors are."""
    return refinement_of(scene) in (bisected, meshed_again)


def more_cells(
    comm: MPI.Comm, scene: Scene, last: Level, finer: float
) -> tuple[Scene, Mesh | None]:
    """Return the scene with more cells along an edge."""
    assert scene.cells is not None
    cells = cells_of(scene, max(scene.cells + 1, scene.cells * finer))
    return scene.model_copy(update={"cells": cells}), None


def smaller_lattice(
    comm: MPI.Comm, scene: Scene, last: Level, finer: float
) -> tuple[Scene, Mesh | None]:
    """Return the scene with a smaller cell of its lattice."""
    assert isinstance(scene.mesh, Lattice)
    cell = scene.mesh.cell / finer
    return scene.model_copy(update={"mesh": scene.mesh.model_copy(update={"cell": cell})}), None


def higher_degree(
    comm: MPI.Comm, scene: Scene, last: Level, finer: float
) -> tuple[Scene, Mesh | None]:
    """Return the scene with an element of degree 2, on the same mesh."""
    return scene.model_copy(update={"element": raised_element(scene)}), last.mesh


def bisected(comm: MPI.Comm, scene: Scene, last: Level, finer: float) -> tuple[Scene, Mesh | None]:
    """Return the mesh whose cells are bisected where the errors are."""

    def bisect(data: MeshData, target: Target, wanted: float) -> MeshData:
        return bisect_times(data, target, wanted, MOST_CELLS)

    mesh = _with_target(comm, scene, last, finer, bisect)
    assert last.mesh is not None
    revolved = kinematics_of(scene.kinematics).revolved
    faces = last.mesh.round_faces or round_faces(last.mesh.domain, revolved)
    return scene, replace(mesh, round_faces=faces)


def meshed_again(
    comm: MPI.Comm, scene: Scene, last: Level, finer: float
) -> tuple[Scene, Mesh | None]:
    """Return a mesh of the exact body, with cells of the sizes that the errors ask for."""

    def mesh(data: MeshData, target: Target, wanted: float) -> MeshData:
        return mesh_like(scene, data, target(wanted))

    return scene, _with_target(comm, scene, last, finer, mesh)


def mesh_like(scene: Scene, data: MeshData, volumes: Array | None = None) -> MeshData:
    """Mesh an exact body again, with cells of other volumes or of those of a mesh. On rank 0."""
    cells = data.cells[:, : data.x.shape[1] + 1]
    volumes = simplex_volumes(data.x[cells]) if volumes is None else volumes
    return mesh_again(scene, data.cell, size_field(cells, data.x, volumes))


def _with_target(
    comm: MPI.Comm,
    scene: Scene,
    last: Level,
    finer: float,
    make: Callable[[MeshData, Target, float], MeshData],
) -> Mesh:
    """Return the mesh that a function makes on rank 0 from the last one. Collective."""
    assert last.mesh is not None
    data, owned = gather(last.mesh), len(last.volumes)
    numbers = _dolfinx.input_cells(last.mesh.domain)[:owned]
    rows = comm.gather((numbers, last.volumes, last.cell_weights()))
    degree, dim = ELEMENTS[scene.element].degree, last.mesh.dim

    def make_on_root() -> MeshData:
        volumes, weights = np.empty((2, len(data.cells)))
        for numbers, *values in rows:
            volumes[numbers], weights[numbers] = values

        def target(growth: float) -> Array:
            return target_volumes(volumes, weights, degree, growth, dim)

        return make(data, target, finer**dim)

    return distribute(comm, "the refined mesh", make_on_root)
