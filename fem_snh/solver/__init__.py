"""Newton's method with filtered Hessians, as a PETSc SNES.

`fem_snh.solver.snes.create` returns the SNES of a problem. ``-snes_view``, monitors, converged
reasons and options work as for PETSc's own types; `options.OPTIONS` lists the additional options.
"""

from fem_snh.solver.errors import callback_errors, petsc_failures
from fem_snh.solver.newton import ProjectedNewton
from fem_snh.solver.predictor import Predictor, solve_linearised
from fem_snh.solver.snes import PREFIX, create, default_globalization, destroy, linear_solver_name
from fem_snh.solver.stability import EquilibriumStability, is_conservative
from fem_snh.solver.step import (
    Iteration,
    StepOutcome,
    converged_reason,
    failure_reason,
    solve_until_settled,
)

__all__ = [
    "PREFIX", "EquilibriumStability", "Iteration", "Predictor", "ProjectedNewton",
    "StepOutcome", "callback_errors", "converged_reason", "create", "default_globalization",
    "destroy", "failure_reason", "is_conservative", "linear_solver_name", "petsc_failures",
    "solve_linearised", "solve_until_settled",
]  # fmt: skip
