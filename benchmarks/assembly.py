"""Assembly time of the filtered Jacobian, relative to FFCx or to stable_neo_hookean."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from time import process_time
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl

from benchmarks import Row, split_list
from fem_snh import _dolfinx
from fem_snh.assembly import elements
from fem_snh.assembly.assembled_matrix import create_matrix
from fem_snh.assembly.regions import Region, whole_body
from fem_snh.kernels.material import Material
from fem_snh.kernels.material import material as make_material
from fem_snh.materials import names
from fem_snh.mesh import mesh
from fem_snh.terms.elastic import Elastic

#: Limit on the ratio to FFCx for each element, and the cells per edge of its mesh.
LIMITS = {"Q1": 0.60, "P1": 1.0, "P2": 0.60, "Q2": 0.60}
CELLS = {"Q1": 24, "P1": 24, "P2": 12, "Q2": 8}

#: The compiler flags of our kernels, for FFCx's code.
JIT = {"cffi_extra_compile_args": ["-O3", "-march=native"]}


#: Limit on the time of any material's filtered Jacobian over that of stable_neo_hookean.
MATERIAL_LIMIT = 1.5


def rows(
    elements: str = "Q1,P1,P2",
    cells: int = 0,
    material: str = "stable_neo_hookean",
    repeat: int = 7,
) -> Iterator[Row]:
    """Measure the assembly on a deformed cube, so that the filter has work in every cell.

    Parameters
    ----------
    cells : int
        Along the edge; default: `CELLS` of each element.
    material : str
        "all" gives one row per material on the first element, relative to stable_neo_hookean;
        otherwise there is one row per element, relative to FFCx.
    repeat : int
        Assemblies of each kind.
    """
    chosen = split_list(elements)
    if material == "all":
        yield from compare(chosen[0], cells or CELLS.get(chosen[0], 8), repeat)
        return
    for name in chosen:
        yield measure(name, cells or CELLS.get(name, 8), material, repeat)


def deformed(name: str, cells: int) -> tuple[Any, Any]:
    """Return the mesh of a cube and a displacement of many short waves on it."""
    element = elements.element(name)
    domain = mesh.generate(MPI.COMM_SELF, "cube", element.cell, cells=cells)
    V = _dolfinx.function_space(domain.domain, element.degree, (3,))
    u = _dolfinx.function(V, "u")
    wave = np.random.default_rng(0).standard_normal((3, 3))
    # J varies by a few per cent: where J > 1 + mu/lambda, flip eigenvalues are negative.
    u.x.array[:] = (0.05 / cells * np.sin(2 * cells * V.tabulate_dof_coordinates() @ wave)).ravel()
    return domain, u


class Hessian:
    """The elastic term of materials on the space of u, with the matrix that it fills."""

    def __init__(self, u: Any, name: str, regions: Sequence[Region]) -> None:
        self.elastic = Elastic(u.function_space, elements.element(name), regions)
        self.matrix = create_matrix(u.function_space)
        self._x = _dolfinx.petsc_vec(u)

    def assemble(self, filter: str) -> int:
        """Assemble the filtered Hessian; return the number of filtered quadrature points."""
        with self.matrix.adding():
            return self.elastic.add_hessian(self._x, None, filter, self.matrix)


def hessian(u: Any, name: str, material: Material) -> Hessian:
    """Return the Hessian of a body of one material."""
    return Hessian(u, name, whole_body(u.function_space.mesh, material))


def times(calls: dict[str, Callable[[], Any]], repeat: int) -> dict[str, np.ndarray]:
    """Return ``repeat`` processor times of each call [s], the calls taken in turns."""
    taken: dict[str, list[float]] = {kind: [] for kind in calls}
    for _ in range(repeat):
        for kind, call in calls.items():
            start = process_time()
            call()
            taken[kind].append(process_time() - start)
    return {kind: np.array(values) for kind, values in taken.items()}


def compare(
    name: str, cells: int, repeat: int, materials: Sequence[str] | None = None
) -> Iterator[Row]:
    """Yield a row per material: its filtered Jacobian, timed in turns with stable_neo_hookean's."""
    domain, u = deformed(name, cells)
    reference = hessian(u, name, make_material("stable_neo_hookean"))
    for material in materials or names():
        term = hessian(u, name, make_material(material))
        filtered = term.assemble("clamp")
        taken = times(
            {
                "clamp": partial(term.assemble, "clamp"),
                "reference": partial(reference.assemble, "clamp"),
            },
            2 * repeat,
        )
        ratio = np.median(
            taken["clamp"] / taken["reference"]
        )  # of measurements that are neighbours in time
        yield {
            "element": name,
            "material": material,
            "cells": domain.num_cells,
            "filtered": round(filtered / points_of(name, domain.num_cells), 3),
            "clamp_us": round(1e6 * taken["clamp"].min() / domain.num_cells, 3),
            "to_stable_neo_hookean": round(float(ratio), 3),
            "limit": MATERIAL_LIMIT,
            "ok": bool(ratio <= MATERIAL_LIMIT),
        }


def points_of(name: str, cells: int) -> int:
    """Return the number of quadrature points of ``cells`` cells."""
    element = elements.element(name)
    return len(_dolfinx.quadrature(element.cell, element.quadrature)[1]) * cells


def measure(name: str, cells: int, material: str, repeat: int) -> Row:
    """Return the row of an element: best of ``repeat`` assemblies of each kind [us per cell]."""
    element = elements.element(name)
    domain, u = deformed(name, cells)
    V = u.function_space
    chosen = make_material(material)
    expression, elastic = chosen.expression, hessian(u, name, chosen)
    filtered = elastic.assemble("clamp")
    calls: dict[str, Callable[[], Any]] = {
        kind: partial(elastic.assemble, kind) for kind in ("exact", "clamp")
    }
    if not expression.needs_stretches:
        v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
        degree = {"quadrature_degree": element.quadrature}
        dx = ufl.Measure("dx", domain=domain.domain, metadata=degree)
        psi = chosen.ufl(ufl.variable(ufl.Identity(3) + ufl.grad(u))) * dx
        form = _dolfinx.form(ufl.derivative(ufl.derivative(psi, u, v), u, w), JIT)
        matrix = _dolfinx.create_matrix(form)
        calls["ffcx"] = lambda: _dolfinx.assemble_matrix(matrix, form)
    best = {kind: taken.min() for kind, taken in times(calls, repeat).items()}
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
