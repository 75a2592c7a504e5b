"""Seconds per cell of the filtered Jacobian, and of FFCx's exact one assembled by dolfinx."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl

from fem_snh import _dolfinx, elements, forms, mesh
from fem_snh.kernels.pointwise import material as make_material
from fem_snh.studies.bench import Row, words
from fem_snh.terms import Elastic

#: What each element's ratio must not exceed, and the cells per edge it is measured on.
LIMITS = {"Q1": 0.60, "P1": 1.0, "P2": 0.60, "Q2": 0.60}
CELLS = {"Q1": 24, "P1": 24, "P2": 12, "Q2": 8}

#: FFCx's code gets the flags our kernels get.
JIT = {"cffi_extra_compile_args": ["-O3", "-march=native"]}


def rows(
    elements: str = "Q1,P1,P2",
    cells: int = 0,
    material: str = "stable_neo_hookean",
    repeat: int = 7,
) -> Iterator[Row]:
    """One row per element, on a cube whose every cell is deformed so that it has to be filtered."""
    for name in words(elements):
        yield measure(name, cells or CELLS.get(name, 8), material, repeat)


def measure(name: str, cells: int, material: str, repeat: int) -> Row:
    """Best of ``repeat`` assemblies of each kind, taken in turns [us per cell of one rank]."""
    element = elements.element(name)
    domain = mesh.generate(MPI.COMM_SELF, "cube", element.cell, cells=cells)
    V = _dolfinx.function_space(domain.domain, element.degree, (3,))
    law = make_material(material, 1.0, 0.49)
    elastic = Elastic(V, element, law)
    elastic.create_matrix()
    u = _dolfinx.function(V, "u")
    wave = np.random.default_rng(0).standard_normal((3, 3))
    # Waves short enough that J varies by a few per cent: beyond 1 + mu/lambda, flips are negative.
    u.x.array[:] = (0.05 / cells * np.sin(2 * cells * V.tabulate_dof_coordinates() @ wave)).ravel()
    x = _dolfinx.petsc_vec(u)
    ways: dict[str, Callable[[], Any]] = {
        kind: lambda kind=kind: elastic.jacobian(x, kind)  # type: ignore[misc]
        for kind in ("exact", "clamp")
    }
    if not law.law.needs_stretches:
        v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
        degree = {"quadrature_degree": element.quadrature}
        dx = ufl.Measure("dx", domain=domain.domain, metadata=degree)
        form = _dolfinx.form(forms.jacobian(law.law, u, v, w, dx), JIT)
        matrix = _dolfinx.create_matrix(form)
        ways["ffcx"] = lambda: _dolfinx.assemble_matrix(matrix, form)
    best = dict.fromkeys(ways, np.inf)
    filtered = 0
    for _ in range(repeat):
        for kind, call in ways.items():
            start = perf_counter()
            result = call()
            best[kind] = min(best[kind], perf_counter() - start)
            filtered = result if kind == "clamp" else filtered
    points = len(_dolfinx.quadrature(element.cell, element.quadrature)[1]) * domain.num_cells
    row: Row = {
        "element": name,
        "material": material,
        "cells": domain.num_cells,
        "dolfinx": _dolfinx.version,
        "filtered": round(filtered / points, 3),
        **{f"{kind}_us": round(1e6 * t / domain.num_cells, 3) for kind, t in best.items()},
    }
    if "ffcx" in best:
        ratio = best["clamp"] / best["ffcx"]
        limit = LIMITS[name]
        row |= {"ratio": round(ratio, 3), "limit": limit, "ok": bool(ratio <= limit)}
    return row
