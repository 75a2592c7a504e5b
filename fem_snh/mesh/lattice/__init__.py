"""Meshes that cover or fill a body: hexahedral lattices with filled fractions, tetrahedra."""

from fem_snh.mesh.lattice.create import create, create_tetrahedra, lattice, tetrahedra

__all__ = ["create", "create_tetrahedra", "lattice", "tetrahedra"]
