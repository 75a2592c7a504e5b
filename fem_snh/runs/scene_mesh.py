"""The mesh of a scene: generated, read or made around a body."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from fem_snh import scenes
from fem_snh.assembly import elements
from fem_snh.mesh import mesh as meshes


def make_mesh(comm: MPI.Comm, scene: scenes.Scene, element: elements.Element) -> meshes.Mesh:
    """Return the scene's mesh, generated or read. Collective."""
    if isinstance(scene.mesh, Path):
        return meshes.read(comm, scene.mesh)
    if isinstance(scene.mesh, scenes.Tetrahedra):
        from fem_snh.mesh import lattice

        return lattice.create_tetrahedra(comm, scene.mesh.body, scene.mesh.size)
    if isinstance(scene.mesh, scenes.Lattice):
        from fem_snh.mesh import lattice

        chosen = scene.mesh
        choices = chosen.cell, chosen.weighting, chosen.parts, chosen.samples, chosen.skin
        return lattice.create(comm, chosen.body, *choices)
    cells = {} if scene.cells is None else {"cells": scene.cells}
    return meshes.generate(comm, scene.mesh.source, element.cell, **cells, **scene.mesh.parameters)
