"""Stable Neo-Hookean flesh simulation in FEniCSx."""

from fem_snh.kernels.pointwise import material
