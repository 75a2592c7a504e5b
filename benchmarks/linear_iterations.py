"""Linear iterations per Newton iteration against mesh size and nu, by linear solver."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import Row, split_list
from fem_snh.errors import choose
from fem_snh.runs import run

#: Incomplete Cholesky factors of the diagonal block of each rank.
ICC = {"pc_type": "bjacobi", "sub_pc_type": "icc"}
#: Solvers of displacement elements.
_SOLVERS: dict[str, dict[str, Any]] = {
    "cg+ssor": {"snes_linear_solver": "iterative"},  # in single precision
    "cg+jacobi": {"ksp_type": "cg", "pc_type": "jacobi"},
    "cg+icc": {"ksp_type": "cg", **ICC},
    "cg+gamg": {"ksp_type": "cg", "pc_type": "gamg"},
    "direct": {"snes_linear_solver": "direct"},
}


def rows(
    cells: str = "6,12,24,48",
    nus: str = "0.3,0.4,0.45,0.49,0.499,0.4999",
    solvers: str = "",
    element: str = "Q1",
    tolerance: float = 1e-3,
    most: int = 24,
) -> Iterator[Row]:
    """Yield one row per mesh and solver at nu = 0.49, then one per nu and solver on one mesh.

    The problem is the stretch by 20 % in one step.

    Parameters
    ----------
    cells : str
        Meshes; the second one is used for the other nu.
    tolerance : float
        Relative tolerance of every linear solve.
    most : int
        Largest number of cells for direct solves.

    Yields
    ------
    dict
        ``linear`` and ``seconds`` are per Newton iteration.
    """
    chosen = [choose("solver", name, _SOLVERS) for name in split_list(solvers)] or list(_SOLVERS)
    meshes = [int(number) for number in split_list(str(cells))]
    plan = [(number, 0.49) for number in meshes]
    plan += [(meshes[min(1, len(meshes) - 1)], float(nu)) for nu in split_list(str(nus))]
    for number, nu in dict.fromkeys(plan):
        for name in chosen:
            if name == "direct" and number > most:
                continue
            petsc = {"snes_forcing_max": 0.0, "ksp_rtol": tolerance} | _SOLVERS[name]
            settings: dict[str, Any] = {"cells": number, "nu": nu, "element": element}
            result = run("stretch", steps=1, stretch=1.2, **settings, petsc=petsc, progress=False)
            newton = sum(step["newton"] for step in result.steps)
            linear = sum(step["linear"] for step in result.steps)
            seconds = sum(step["seconds"] for step in result.steps)
            yield {
                "solver": name,
                **settings,
                "dofs": result.record["dofs"],
                "ranks": result.record["ranks"],
                "converged": result.converged,
                "newton": newton,
                "linear": round(linear / newton, 1),
                "seconds": round(seconds / newton, 4),
            }
