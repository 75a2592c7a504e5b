"""Bodies whose surfaces a barrier keeps apart, for the tests of self-contact by ipctk."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable, Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Condition, Hold, create_problem

from fem_snh import solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Filling
from fem_snh.contact.barrier import IPC
from fem_snh.contact.ipctk_import import import_ipctk
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.problem.problem import Problem
from fem_snh.steps.stepping import Stepper, StepSolver


def _reason() -> str:
    """Return why ipctk does not work on this processor; empty if it does."""
    if sys.platform == "linux" and platform.machine() != "x86_64":
        return "ipctk has no wheel for Linux on this processor"
    try:
        import_ipctk()
    except BadInput as error:
        return str(error) if "crashed" in str(error) else ""  # a missing package is a failure
    return ""


_REASON = _reason()
needs_ipctk = pytest.mark.skipif(bool(_REASON), reason=_REASON or "ipctk works")
#: The gap between two blocks at the start.
GAP = 0.05


def pressed(
    comm: MPI.Comm = MPI.COMM_WORLD,
    element: str = "P1",
    cells: tuple[int, int] = (2, 3),
    press: float = 0.3,
    shear: float = 0.0,
    nu: float = 0.4,
    hold: Any = (Hold("bottom"),),
    components: tuple[str, ...] = ("x", "y", "z"),
    move: Any = None,
    terms: Any = None,
    E: float = 1.0,
    **options: Any,
) -> tuple[Problem, IPC]:
    """Return a problem of two blocks of density 1, the upper of which moves down, then sideways.

    With ``shear`` the motion downwards ends at load 1/2. ``move`` replaces the motion, ``terms``
    returns further terms, ``options`` are those of `IPC`.
    """
    body = mesh.generate(
        comm, "two_blocks", ELEMENTS[element].cell, cells=cells[0], upper_cells=cells[1], gap=GAP
    )
    made = list[IPC]()

    def loads(body: Any, u: Any, regions: Any, dirichlet: Any) -> list[Any]:
        made.append(IPC(u.function_space, body.skin, regions, **options))
        return [*made, *(terms(u, regions, dirichlet) if terms else [])]

    def press_down(X: np.ndarray, load: float) -> np.ndarray:
        down, side = (min(1, 2 * load), max(0, 2 * load - 1)) if shear else (load, 0)
        return np.broadcast_to([shear * side, 0.0, -press * down], X.shape).copy()

    problem = create_problem(
        body,
        ELEMENTS[element],
        [Filling(material("stable_neo_hookean", E, nu), None, 1.0)],
        hold=hold,
        move=[Condition("top", press_down, components)] if move is None else move,
        loads=loads,
    )
    return problem, made[0]


def steps(
    problem: Problem,
    number: int,
    predictor: str = "extrapolate",
    tolerance: float = 1e-10,
    globalization: str | None = None,
    update: Callable[[Any, int], None] | None = None,
) -> Iterator[dict[str, Any]]:
    """Take load steps; yield their rows. ``update(snes, iteration)`` is SNESSetUpdate's."""
    snes = solver.create(problem, globalization=globalization)
    if update is not None:
        snes.setUpdate(update)
    snes.getPythonContext().options["snes_scaled_tol"] = tolerance
    yield from Stepper(StepSolver(problem, snes, predictor), number)


def points(problem: Problem, term: IPC) -> np.ndarray:
    """Return the present positions of the surface's points. Collective."""
    u = problem.x.array_r[: problem.coordinates.size].reshape(-1, 3)
    return np.asfortranarray(term.surface.positions(u))


def intersects(problem: Problem, term: IPC) -> bool:
    """Return ipctk's verdict on the present surface, without the program's wrapper. Collective."""
    import ipctk

    x, triangles = points(problem, term), term.surface.triangles
    surface = ipctk.CollisionMesh(x, ipctk.edges(triangles), triangles)
    return bool(ipctk.has_intersections(surface, x))
