"""Sheets, struts and columns: the program's linear solver and the other one, in counts.

Each body is solved in one step at default settings: a sheet and a strut are clamped at one end, and
the other end is moved; a column is clamped at one end and has a dead load on the other, in
multiples of Euler's.
"""

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

#: Cells and edges [m] of each body, Poisson's ratio, the motion of its end [m], or the load on it
#: over Euler's and its part to the side.
BODIES: dict[str, tuple[tuple[int, ...], tuple[float, ...], float, tuple[float, ...]]] = {
    "sheet 1:100": ((20, 20, 1), (1, 1, 0.01), 0.49, (0.3, 0.2, 0.0)),
    "sheet 1:1000": ((20, 20, 1), (1, 1, 0.001), 0.49, (0.3, 0.2, 0.0)),
    "strut 1:10, bent": ((60, 4, 4), (10, 1, 1), 0.49, (0.0, 1.0, 0.0)),
    "strut 1:60, bent": ((60, 2, 2), (60, 1, 1), 0.49, (0.0, 6.0, 0.0)),
    "strut 1:10, pressed": ((60, 4, 4), (10, 1, 1), 0.3, (-0.5, 0.0, 0.0)),
    "strut 1:60, pressed": ((60, 2, 2), (60, 1, 1), 0.3, (-3.0, 0.0, 0.0)),
    "column 1:20, 1.5": ((20, 2, 2), (20, 1, 1), 0.3, (1.5, 0.0)),
    "column 1:20, 1.5, to the side": ((20, 2, 2), (20, 1, 1), 0.3, (1.5, 1e-3)),
    "column 1:60, 2.4": ((60, 2, 2), (60, 1, 1), 0.3, (2.4, 0.0)),
    "column 1:60, 2.4, to the side": ((60, 2, 2), (60, 1, 1), 0.3, (2.4, 1e-3)),
}
#: What each body is solved with.
SOLVERS = {"default": {}, "iterative": {"snes_linear_solver": "iterative"}}


def rows(bodies: str = "", solvers: str = "default,iterative") -> Iterator[Row]:
    """Yield a row per body and solver.

    Parameters
    ----------
    bodies : str
        Beginnings of the names of `BODIES`; default: all.
    solvers : str
        Of `SOLVERS`.

    Yields
    ------
    dict
        ``newton``, ``linear``, ``lbfgs``: iterations; ``energy`` [J]; ``negative``: eigenvalues of
        the Hessian at the end; ``seconds``: processor seconds; ``reason``.
    """
    chosen = split_list(bodies) or ("",)
    for name, body in BODIES.items():
        for kind in split_list(solvers) if name.startswith(tuple(chosen)) else ():
            yield {"body": name, "solver": kind} | _row(
                SOLVERS[choose("solver", kind, SOLVERS)], *body
            )


def _row(
    options: dict[str, Any],
    cells: tuple[int, ...],
    edges: tuple[float, ...],
    nu: float,
    end: tuple[float, ...],
) -> Row:
    """Return the measurements of a body."""
    corners = [np.zeros(3), np.array(edges, float)]
    body = mesh.create_box(MPI.COMM_WORLD, corners, list(cells), mesh.CellType.hexahedron)
    V = _dolfinx.function_space(body, 1, (3,))
    u = fem.Function(V)
    foot, head = (
        fem.locate_dofs_geometrical(V, lambda x, at=at: np.isclose(x[0], at))
        for at in (0, edges[0])
    )
    bcs, terms = [fem.dirichletbc(np.zeros(3), foot, V)], []
    if len(end) == 3:
        bcs.append(fem.dirichletbc(np.array(end), head, V))
    else:
        facets = np.sort(
            mesh.locate_entities_boundary(body, 2, lambda x: np.isclose(x[0], edges[0]))
        )
        tags = mesh.meshtags(body, 2, facets, np.ones(len(facets), np.int32))
        ds = ufl.Measure("ds", domain=body, subdomain_data=tags)
        load, side = end
        euler = np.pi**2 * edges[1] ** 2 / 12 / (4 * edges[0] ** 2)
        traction = fem.Constant(body, load * euler * np.array([-1.0, side, 0.0]))
        terms = [-ufl.inner(traction, u) * ds(1)]
    m = fem_snh.material("stable_neo_hookean", E=1.0, nu=nu)
    problem = fem_snh.NonlinearProblem(u, {m: ufl.dx}, bcs=bcs, terms=terms, petsc_options=options)
    start = process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResultNote)
        problem.solve()
    seconds = process_time() - start
    context = problem.solver.getPythonContext()
    return {
        "newton": problem.newton,
        "linear": problem.linear,
        "lbfgs": sum(iteration.lbfgs for iteration in context.history),
        "energy": context.history[-1].energy if context.history else 0.0,
        "negative": problem.negative_eigenvalues(),
        "seconds": round(seconds, 2),
        "reason": problem.reason,
    }
