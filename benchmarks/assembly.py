"""Seconds per cell of the filtered Jacobian, beside FFCx's exact one or stable_neo_hookean's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from time import process_time
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl

from benchmarks import Row, split_list
from fem_snh import _dolfinx
from fem_snh.fem import elements, mesh, ufl_forms
from fem_snh.fem.terms import Elastic
from fem_snh.kernels.pointwise import Material
from fem_snh.kernels.pointwise import material as make_material
from fem_snh.materials import names

#: What each element's ratio must not exceed, and the cells per edge it is measured on.
LIMITS = {"Q1": 0.60, "P1": 1.0, "P2": 0.60, "Q2": 0.60}
CELLS = {"Q1": 24, "P1": 24, "P2": 12, "Q2": 8}

#: FFCx's code gets the flags our kernels get.
JIT = {"cffi_extra_compile_args": ["-O3", "-march=native"]}


#: No material's filtered Jacobian is to cost more than this many of stable_neo_hookean's.
MOST = 1.5


def rows(
    elements: str = "Q1,P1,P2",
    cells: int = 0,
    material: str = "stable_neo_hookean",
    repeat: int = 7,
) -> Iterator[Row]:
    """One row per element, on a cube whose every cell is deformed so that it has to be filtered.

    ``material="all"``: a row per material on the first element, against stable_neo_hookean.
    """
    chosen = split_list(elements)
    if material == "all":
        yield from compare(chosen[0], cells or CELLS.get(chosen[0], 8), repeat)
        return
    for name in chosen:
        yield measure(name, cells or CELLS.get(name, 8), material, repeat)


def deformed(name: str, cells: int) -> tuple[Any, Any]:
    """A space on a cube and a displacement of many short waves."""
    element = elements.element(name)
    domain = mesh.generate(MPI.COMM_SELF, "cube", element.cell, cells=cells)
    V = _dolfinx.function_space(domain.domain, element.degree, (3,))
    u = _dolfinx.function(V, "u")
    wave = np.random.default_rng(0).standard_normal((3, 3))
    # Waves short enough that J varies by a few per cent: beyond 1 + mu/lambda, flips are negative.
    u.x.array[:] = (0.05 / cells * np.sin(2 * cells * V.tabulate_dof_coordinates() @ wave)).ravel()
    return domain, u


def elastic_term(u: Any, name: str, material: Material) -> Elastic:
    """The material's elastic term on u's space, ready to assemble."""
    return Elastic(u.function_space, elements.element(name), material)


def times(ways: dict[str, Callable[[], Any]], repeat: int) -> dict[str, np.ndarray]:
    """Each way's ``repeat`` times of the processor [s], taken in turns."""
    taken: dict[str, list[float]] = {kind: [] for kind in ways}
    for _ in range(repeat):
        for kind, call in ways.items():
            start = process_time()
            call()
            taken[kind].append(process_time() - start)
    return {kind: np.array(list_) for kind, list_ in taken.items()}


def compare(
    name: str, cells: int, repeat: int, materials: Sequence[str] | None = None
) -> Iterator[Row]:
    """Every material's filtered Jacobian beside stable_neo_hookean's, in turns with it."""
    domain, u = deformed(name, cells)
    x = _dolfinx.petsc_vec(u)
    reference = elastic_term(u, name, make_material("stable_neo_hookean"))
    for material in materials or names():
        term = elastic_term(u, name, make_material(material))
        filtered = term.jacobian(x, filter="clamp")
        taken = times(
            {
                "clamp": lambda term=term: term.jacobian(x, filter="clamp"),  # type: ignore[misc]
                "reference": lambda: reference.jacobian(x, filter="clamp"),
            },
            2 * repeat,
        )
        ratio = np.median(taken["clamp"] / taken["reference"])  # of neighbours in time
        yield {
            "element": name,
            "material": material,
            "cells": domain.num_cells,
            "filtered": round(filtered / points_of(name, domain.num_cells), 3),
            "clamp_us": round(1e6 * taken["clamp"].min() / domain.num_cells, 3),
            "to_stable_neo_hookean": round(float(ratio), 3),
            "limit": MOST,
            "ok": bool(ratio <= MOST),
        }


def points_of(name: str, cells: int) -> int:
    """Quadrature points of so many cells."""
    element = elements.element(name)
    return len(_dolfinx.quadrature(element.cell, element.quadrature)[1]) * cells


def measure(name: str, cells: int, material: str, repeat: int) -> Row:
    """Best of ``repeat`` assemblies of each kind, taken in turns [us per cell of one rank]."""
    element = elements.element(name)
    domain, u = deformed(name, cells)
    V, x = u.function_space, _dolfinx.petsc_vec(u)
    chosen = make_material(material)
    law, elastic = chosen.expression, elastic_term(u, name, chosen)
    filtered = elastic.jacobian(x, filter="clamp")
    ways: dict[str, Callable[[], Any]] = {
        kind: lambda kind=kind: elastic.jacobian(x, filter=kind)  # type: ignore[misc]
        for kind in ("exact", "clamp")
    }
    if not law.needs_stretches:
        v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
        degree = {"quadrature_degree": element.quadrature}
        dx = ufl.Measure("dx", domain=domain.domain, metadata=degree)
        form = _dolfinx.form(ufl_forms.jacobian(law, u, v, w, dx), JIT)
        matrix = _dolfinx.create_matrix(form)
        ways["ffcx"] = lambda: _dolfinx.assemble_matrix(matrix, form)
    best = {kind: taken.min() for kind, taken in times(ways, repeat).items()}
    row: Row = {
        "element": name,
        "material": material,
        "cells": domain.num_cells,
        "dolfinx": _dolfinx.version,
        "filtered": round(filtered / points_of(name, domain.num_cells), 3),
        **{f"{kind}_us": round(1e6 * t / domain.num_cells, 3) for kind, t in best.items()},
    }
    if "ffcx" in best:
        ratio = best["clamp"] / best["ffcx"]
        limit = LIMITS[name]
        row |= {"ratio": round(ratio, 3), "limit": limit, "ok": bool(ratio <= limit)}
    return row
