"""Meshes: gmsh geometries and files, groups, lattices around shapes, their skin."""
