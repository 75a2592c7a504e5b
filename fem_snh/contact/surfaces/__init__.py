"""Surfaces in contact: quadrature, gathering on every rank, closest facets, gaps."""
