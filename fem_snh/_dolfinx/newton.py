"""dolfinx's own Newton solver, as its tutorial uses it: what ours is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
from dolfinx import fem
from dolfinx.nls.petsc import NewtonSolver

from fem_snh._dolfinx.common import _quiet
from fem_snh._dolfinx.forms import _jit
from fem_snh._petsc import default_options


def prescribed(values: Any, nodes: np.ndarray) -> Any:
    """The condition that u is as the function ``values`` at these local nodes."""
    return fem.dirichletbc(values, np.asarray(nodes, np.int32))


def newton_solver(
    residual: Any, u: Any, conditions: Sequence[Any], jit_options: dict, petsc: dict[str, Any]
) -> Any:
    """Full Newton steps with the exact tangent, stopped by the residual's norm.

    ``atol``, ``rtol`` and ``max_it`` are the caller's to set; ``petsc``: options of the linear
    solver. Its ``solve(u)`` returns (iterations, converged).
    """
    # Since 0.10 the name alone is that of an interface to PETSc's SNES.
    kind = getattr(fem_petsc, "NewtonSolverNonlinearProblem", fem_petsc.NonlinearProblem)
    with _quiet():
        problem = kind(residual, u, list(conditions), **_jit(kind.__init__, jit_options))
        solver = NewtonSolver(u.function_space.mesh.comm, problem)
    solver.convergence_criterion = "residual"
    solver.error_on_nonconvergence = False
    solver.report = False
    ksp = solver.krylov_solver
    with default_options(ksp.getOptionsPrefix(), petsc):
        ksp.setFromOptions()
    return solver
