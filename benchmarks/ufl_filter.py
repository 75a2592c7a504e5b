"""Time of the filtered Hessian of a material as a UFL term, over that of its kernels.

The kernels filter at every quadrature point in closed form; a UFL term filters FFCx's element
matrices by their eigenvalues.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl

from benchmarks import Row, split_list
from benchmarks.assembly import CELLS, times
from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import create_matrix
from fem_snh.assembly.elements import element as element_of
from fem_snh.assembly.regions import whole_body
from fem_snh.choices import FILTERS
from fem_snh.kernels.material import material as make_material
from fem_snh.mesh import mesh
from fem_snh.terms.elastic import Elastic
from fem_snh.terms.ufl_term import UFLTerm


def rows(
    elements: str = "Q1,P1,P2",
    cells: int = 0,
    material: str = "stable_neo_hookean",
    amplitude: str = "0.005,0.02",
    repeat: int = 5,
) -> Iterator[Row]:
    """Yield one row per element, deformation and filter.

    Parameters
    ----------
    cells : int
        Along the edge; default: `benchmarks.assembly.CELLS` of each element.
    amplitude : str
        Of short waves, in cells: the higher they are, the more element matrices are indefinite.
    repeat : int
        Assemblies of each kind.

    Yields
    ------
    dict
        ``us_per_cell``, ``kernels_us_per_cell``: processor time; ``ratio``: of the two;
        ``indefinite``: part of the cells whose element matrix is filtered.
    """
    for name in split_list(elements):
        number = cells or CELLS.get(name, 8)
        for height in split_list(str(amplitude)):
            yield from _measure(name, number, material, float(height), repeat)


def _measure(name: str, cells: int, material: str, amplitude: float, repeat: int) -> Iterator[Row]:
    element = element_of(name)
    domain = mesh.generate(MPI.COMM_SELF, "cube", element.cell, cells=cells).domain
    V = _dolfinx.function_space(domain, element.degree, (3,))
    u = _dolfinx.function(V, "u")
    solid = make_material(material, E=1.0, nu=0.49)
    dx = ufl.Measure("dx", domain, metadata={"quadrature_degree": element.quadrature})
    form = solid.ufl(ufl.Identity(3) + ufl.grad(u)) * dx
    kernels, term = Elastic(V, element, whole_body(domain, solid)), UFLTerm(form, u)
    matrix, x, count = create_matrix(V), _dolfinx.petsc_vec(u), _dolfinx.num_owned(domain)
    wave = np.random.default_rng(0).standard_normal((3, 3))
    waves = np.sin(2 * cells * V.tabulate_dof_coordinates() @ wave)
    u.x.array[:] = (amplitude / cells * waves).ravel()

    def assemble(part: Any, filter: str) -> int:
        with matrix.adding():
            return int(part.add_hessian(x, None, filter, matrix))

    for filter in FILTERS:
        calls: dict[str, Callable[[], Any]] = {
            "kernels": partial(assemble, kernels, filter),
            "ufl": partial(assemble, term, filter),
        }
        taken = {kind: 1e6 * t.min() / count for kind, t in times(calls, repeat).items()}
        yield {
            "element": name,
            "cells": count,
            "amplitude": amplitude,
            "filter": filter,
            "us_per_cell": round(taken["ufl"], 2),
            "kernels_us_per_cell": round(taken["kernels"], 2),
            "ratio": round(taken["ufl"] / taken["kernels"], 1),
            "indefinite": round(assemble(term, filter) / count, 3),
        }
