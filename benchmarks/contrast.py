"""A stiff inclusion in a soft cube: iterations over the contrast of the moduli."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from time import process_time
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

import fem_snh
from benchmarks import Row, split_list
from fem_snh import _dolfinx
from fem_snh.errors import ResultNote, choose

#: What the inclusions fill, by the cells' midpoints from the middle of the unit cube, (n, 3).
SHAPES = {
    "cylinder": lambda c: (np.hypot(c[:, 0], c[:, 1]) < 0.25) & (np.abs(c[:, 2]) < 0.3),
    "sphere": lambda c: np.linalg.norm(c, axis=1) < 0.3,
    "bar": lambda c: (np.abs(c) < [0.31, 0.11, 0.11]).all(axis=1),
}
#: What each is solved with.
SOLVERS = {"default": {}, "iterative": {"snes_linear_solver": "iterative"}}


def rows(
    shapes: str = "cylinder,sphere,bar",
    contrasts: str = "1,1e2,1e4,1e6,1e8",
    cells: int = 10,
    solvers: str = "default,iterative",
) -> Iterator[Row]:
    """Yield a row per shape, contrast and solver: a face is moved by (0.3, 0.2, 0) in one step.

    Yields
    ------
    dict
        ``newton``, ``linear``: iterations; ``energy`` [J]; ``reason``; ``seconds`` of processor.
    """
    for shape in split_list(shapes):
        for contrast in map(float, split_list(contrasts)):
            for kind in split_list(solvers):
                options = SOLVERS[choose("solver", kind, SOLVERS)]
                row = {"shape": shape, "contrast": contrast, "solver": kind}
                yield row | _row(SHAPES[choose("shape", shape, SHAPES)], contrast, cells, options)


def _row(shape: Any, contrast: float, cells: int, options: dict[str, Any]) -> Row:
    """Return the measurements of a cube."""
    problem = inclusion(MPI.COMM_WORLD, shape, contrast, cells, options)
    start = process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResultNote)
        problem.solve()
    return {
        "newton": problem.newton,
        "linear": problem.linear,
        "energy": problem.solver.computeObjective(problem.x),
        "reason": problem.reason,
        "seconds": round(process_time() - start, 2),
    }


def inclusion(
    comm: MPI.Comm, shape: Any, contrast: float, cells: int, options: dict[str, Any]
) -> fem_snh.NonlinearProblem:
    """Return the problem of a cube with an inclusion of ``contrast`` times its modulus."""
    body = mesh.create_unit_cube(comm, cells, cells, cells, mesh.CellType.hexahedron)
    V = _dolfinx.function_space(body, 1, (3,))
    bcs = [
        fem.dirichletbc(
            np.array(value),
            fem.locate_dofs_geometrical(V, lambda x, at=at: np.isclose(x[0], at)),
            V,
        )
        for at, value in ((0.0, [0.0, 0.0, 0.0]), (1.0, [0.3, 0.2, 0.0]))
    ]
    nodes = _dolfinx.node_dofs(V)
    inside = shape(V.tabulate_dof_coordinates()[nodes].mean(axis=1) - 0.5)
    tags = mesh.meshtags(body, 3, np.arange(len(nodes), dtype=np.int32), inside.astype(np.int32))
    dx = ufl.Measure("dx", domain=body, subdomain_data=tags)
    name = "stable_neo_hookean"
    materials = {fem_snh.material(name, E=1.0, nu=0.49): dx(0)}
    materials[fem_snh.material(name, E=contrast, nu=0.49)] = dx(1)
    if contrast == 1:
        materials = {fem_snh.material(name, E=1.0, nu=0.49): ufl.dx}
    return fem_snh.NonlinearProblem(
        _dolfinx.function(V, "u"), materials, bcs=bcs, petsc_options=options
    )
