"""Meshes that cover or fill a body: hexahedral lattices with filled fractions, tetrahedra."""

from fem_snh.mesh.lattice.create import create, lattice
from fem_snh.mesh.lattice.tetrahedra import create_tetrahedra, tetrahedra

__all__ = ["create", "create_tetrahedra", "lattice", "tetrahedra"]
