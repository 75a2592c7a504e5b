"""A bushing with a steel sleeve and an arm with elastic bones: parts that turn by large angles.

The sleeve's inner surface turns by 40 degrees in one step. The arm's upper bone is held and its
lower one is turned, each at the end away from the elbow, by 30 degrees in one step. A part has
``contrast`` times the modulus of the rest: steel beside rubber 2e5, bone beside flesh 1e5.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from math import radians
from time import process_time
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh

import fem_snh
from benchmarks import Row, split_list
from fem_snh import _dolfinx
from fem_snh.errors import ResultNote, choose
from fem_snh.geometry.rotations import rotate
from fem_snh.mesh.mesh import generate

Array = npt.NDArray[Any]

#: Radii of the bushing [mm], and how thick its sleeve is: one of four cells.
INNER, OUTER, SLEEVE = 10.0, 20.0, 2.5
#: Parts of the bones' lengths from the arm's ends, at which they are held [m].
GRIP = 0.06


def rows(
    bodies: str = "bushing,elbow", contrasts: str = "1,1e5,2e5", cells: int = 0
) -> Iterator[Row]:
    """Yield a row per body and contrast.

    Yields
    ------
    dict
        ``newton``, ``linear``: iterations; ``energy``; ``reason``; ``seconds`` of processor.
    """
    for name in split_list(bodies):
        make = BODIES[choose("body", name, BODIES)]
        for contrast in map(float, split_list(contrasts)):
            problem = make(MPI.COMM_WORLD, contrast, **({"cells": cells} if cells else {}))
            start = process_time()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ResultNote)
                problem.solve()
            yield {
                "body": name,
                "contrast": contrast,
                "dofs": problem.x.getSize(),
                "newton": problem.newton,
                "linear": problem.linear,
                "energy": problem.solver.computeObjective(problem.x),
                "reason": problem.reason,
                "seconds": round(process_time() - start, 2),
            }


def bushing(
    comm: MPI.Comm, contrast: float, cells: int = 4, angle: float = 40.0, E: float = 1e6
) -> fem_snh.NonlinearProblem:
    """Return a bushing about the y axis whose sleeve turns about it by an angle [degrees]."""
    sizes = {"inner": INNER, "outer": OUTER, "length": 20.0, "section": 0.0, "order": 1.0}
    domain = generate(comm, "bushing", "hexahedron", cells=cells, **sizes).domain
    turn = np.array([0.0, radians(angle), 0.0])

    def radius(x: Array) -> Array:
        return np.hypot(x[:, 0], x[:, 2])

    return _problem(
        domain,
        lambda x: radius(x) < INNER + SLEEVE,
        [(lambda x: radius(x) > OUTER * 0.999, None), (lambda x: radius(x) < INNER * 1.001, turn)],
        E, 0.45, contrast,
    )  # fmt: skip


def elbow(
    comm: MPI.Comm, contrast: float, cells: int = 20, angle: float = 30.0, E: float = 3e4
) -> fem_snh.NonlinearProblem:
    """Return an arm whose elbow flexes by an angle [degrees], at grips on its elastic bones."""
    mesh = generate(comm, "arm", "tetrahedron", cells=cells)
    bones = np.concatenate([mesh.group(name).entities for name in ("humerus", "ulna")])
    turn = np.array([0.0, -radians(angle), 0.0])
    V = _dolfinx.function_space(mesh.domain, 1, (3,))
    in_bones = np.unique(_dolfinx.node_dofs(V)[bones])
    x = V.tabulate_dof_coordinates()
    ends = [
        comm.allreduce(float(x[in_bones, 0].min(initial=np.inf)), op=MPI.MIN),
        comm.allreduce(float(x[in_bones, 0].max(initial=-np.inf)), op=MPI.MAX),
    ]
    inside = np.zeros(len(x), bool)
    inside[in_bones] = True
    grips = [
        (lambda x: inside & (x[:, 0] < ends[0] + GRIP), None),
        (lambda x: inside & (x[:, 0] > ends[1] - GRIP), turn),
    ]
    return _problem(mesh.domain, bones, grips, E, 0.45, contrast)


BODIES: dict[str, Callable[..., fem_snh.NonlinearProblem]] = {"bushing": bushing, "elbow": elbow}


def _problem(
    domain: Any,
    stiff: Array | Callable[[Array], Array],
    conditions: list[tuple[Callable[[Array], Array], Array | None]],
    E: float,
    nu: float,
    contrast: float,
) -> fem_snh.NonlinearProblem:
    """Return the problem of a soft and a stiff material.

    Parameters
    ----------
    domain : dolfinx Mesh
    stiff : array or callable
        The cells of the stiff material, or which of the cells with these midpoints are.
    conditions : list
        Which nodes are held, and the rotation vector about the origin of those that turn.
    E, nu, contrast : float
    """
    V = _dolfinx.function_space(domain, 1, (3,))
    nodes, x = _dolfinx.node_dofs(V), V.tabulate_dof_coordinates()
    inside = np.zeros(len(nodes), np.int32)
    inside[stiff(x[nodes].mean(axis=1)) if callable(stiff) else stiff] = 1
    cells = np.arange(len(nodes), dtype=np.int32)
    dx = ufl.Measure("dx", domain=domain, subdomain_data=dolfinx_mesh.meshtags(
        domain, 3, cells, inside
    ))  # fmt: skip
    bcs = []
    for where, turn in conditions:
        values = fem.Function(V)
        if turn is not None:
            values.x.array[:] = (rotate(np.tile(turn, (len(x), 1)), x) - x).ravel()
        bcs.append(fem.dirichletbc(values, np.flatnonzero(where(x)).astype(np.int32)))
    name = "stable_neo_hookean"
    soft = fem_snh.material(name, E=E, nu=nu)
    materials = {soft: dx(0), fem_snh.material(name, E=contrast * E, nu=nu): dx(1)}
    return fem_snh.NonlinearProblem(_dolfinx.function(V, "u"), materials, bcs=bcs)
