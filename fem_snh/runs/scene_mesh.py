"""The mesh of a scene: generated, read or made around a body."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from fem_snh import scenes
from fem_snh.assembly import elements
from fem_snh.mesh import gmsh_input
from fem_snh.mesh import mesh as meshes

if TYPE_CHECKING:
    from fem_snh.mesh.gmsh_model import SizeField


def make_mesh(comm: MPI.Comm, scene: scenes.Scene, element: elements.Element) -> meshes.Mesh:
    """Return the scene's mesh, generated or read. Collective."""
    if isinstance(scene.mesh, Path):
        return meshes.read(comm, scene.mesh, **_cells(scene))
    if isinstance(scene.mesh, scenes.Tetrahedra):
        from fem_snh.mesh import lattice

        return lattice.create_tetrahedra(comm, scene.mesh.body, scene.mesh.size)
    if isinstance(scene.mesh, scenes.Lattice):
        from fem_snh.mesh import lattice

        chosen = scene.mesh
        choices = chosen.cell, chosen.weighting, chosen.parts, chosen.samples, chosen.skin
        return lattice.create(comm, chosen.body, *choices)
    parameters = _cells(scene) | scene.mesh.parameters
    return meshes.generate(comm, scene.mesh.source, element.cell, **parameters)


def mesh_again(scene: scenes.Scene, cell: str, sizes: SizeField) -> gmsh_input.MeshData:
    """Mesh the exact geometry of a scene with a field of sizes. On rank 0."""
    if isinstance(scene.mesh, Path):
        return gmsh_input.mesh_shape(str(scene.mesh), sizes=sizes, **_cells(scene))
    assert isinstance(scene.mesh, scenes.Geometry)
    parameters = {**_cells(scene), **scene.mesh.parameters}
    source = gmsh_input.source_path(scene.mesh.source)
    return gmsh_input.generate(source, cell, parameters, sizes)


def _cells(scene: scenes.Scene) -> dict[str, int]:
    return {} if scene.cells is None else {"cells": scene.cells}
