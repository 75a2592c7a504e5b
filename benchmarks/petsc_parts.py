"""The built-in linear solver beside PETSc's parts of the same kind, on the twist and the stretch.

PCEISENSTAT is Eisenstat's form of SSOR for the matrix of one rank; on several ranks it solves each
rank's block (block Jacobi). PCDEFLATION builds its deflation space without coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median
from typing import Any

from mpi4py import MPI

from benchmarks import Row, policy, split_list
from fem_snh.errors import BadInput, Failed, choose
from fem_snh.runs import run

_CG = {"ksp_type": "cg", "ksp_max_it": 2000}
#: The norm of EisenstatCG, so that relative tolerances mean the same.
_NATURAL = {"ksp_norm_type": "natural"}
_BLOCKS = {"pc_type": "bjacobi", "sub_pc_type": "eisenstat"}
_DEFLATION = {"pc_type": "deflation"}
_AGGREGATION = {"pc_deflation_compute_space": "aggregation"}

#: PETSc options of the linear solvers by the name that --solvers takes. PETSc's default deflation
#: space is one level of Haar wavelets; "initial" deflates the initial guess only.
SOLVERS: dict[str, dict[str, Any]] = {
    "built_in": {},
    "built_in_not_deflated": {"ksp_deflation_subdomains": 0},
    "sor": _CG | _NATURAL | {"pc_type": "sor", "pc_sor_local_symmetric": None},
    "eisenstat": _CG
    | _NATURAL
    | ({"pc_type": "eisenstat"} if MPI.COMM_WORLD.size == 1 else _BLOCKS),
    "deflation": _CG | _DEFLATION,
    "deflation_aggregation": _CG | _DEFLATION | _AGGREGATION,
    "deflation_initial": _CG
    | _DEFLATION
    | _AGGREGATION
    | {"pc_deflation_init_only": None, "deflation_pc_type": "none"},
}
#: Solvers that are expected to fail: CG ends with an indefinite preconditioner in the first steps.
EXPECTED_FAILURES = ("deflation", "deflation_aggregation")

#: Linear solves are so precise that the path of the twist does not depend on rounding.
_TOLERANCE = {"snes_forcing_max": 5e-3}
#: Cells and load steps of the scenes.
SCENES = {"twist": {"cells": 15, "steps": 2}, "stretch": {"cells": 12, "steps": 12}}


def rows(
    scenes: str = "twist,stretch",
    solvers: str = ",".join(SOLVERS),
    cells: int = 0,
    steps: int = 0,
    nu: float = 0.49,
    hessian: str = "clamp",
    repeat: int = 3,
) -> Iterator[Row]:
    """Yield one row per scene and linear solver, on the ranks it is started on.

    Parameters
    ----------
    cells, steps : int
        Cells along an edge and steps of every scene; 0 for those of `SCENES`.
    hessian : str
        "clamp" or "abs": the other policies give matrices that CG rejects by design.
    repeat : int
        Number of runs; ``seconds`` is the median of the time in the solver.

    Yields
    ------
    dict
        ``newton`` and ``linear``: iterations of all steps. ``reason``: why it failed. ``expected``:
        "converges", or why a failure is expected.
    """
    for scene in split_list(scenes):
        settings: dict[str, Any] = SCENES[choose("scene", scene, SCENES)] | {"nu": nu}
        settings |= policy(hessian)
        settings |= {key: value for key, value in (("cells", cells), ("steps", steps)) if value}
        for name in split_list(solvers):
            petsc = _TOLERANCE | SOLVERS[choose("solver", name, SOLVERS)]
            row: Row = {"scene": scene, "solver": name, "ranks": MPI.COMM_WORLD.size}
            row |= {"cells": settings["cells"], "steps": settings["steps"]}
            failure = "may fail: PCDEFLATION is singular" if name in EXPECTED_FAILURES else ""
            yield (
                row
                | _measure(scene, settings, petsc, repeat)
                | {"expected": failure or "converges"}
            )


def _measure(scene: str, settings: dict[str, Any], petsc: dict[str, Any], repeat: int) -> Row:
    """Run a scene ``repeat`` times, or once if it fails; return iterations and median time."""
    seconds = []
    for _ in range(max(1, repeat)):
        try:
            result = run(scene, **settings, petsc=petsc, progress=False)
        except (BadInput, Failed) as error:
            return {"converged": False, "reason": str(error)}
        seconds.append(result.record["seconds"]["solve"])
        if not result.converged:
            break
    return {
        "dofs": result.record["dofs"],
        "newton": sum(step["newton"] for step in result.steps),
        "linear": sum(step["linear"] for step in result.steps),
        "converged": result.converged,
        "reason": "" if result.converged else result.steps[-1]["reason"],
        "seconds": round(median(seconds), 4),
    }
