"""dolfinx's Newton solver as its tutorial uses it, for comparison in benchmarks."""

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
    """Return the Dirichlet condition with the function ``values`` at these local nodes."""
    return fem.dirichletbc(values, np.asarray(nodes, np.int32))


def newton_solver(
    residual: Any, u: Any, conditions: Sequence[Any], jit_options: dict, petsc: dict[str, Any]
) -> Any:
    """Return a Newton solver without line search that stops on the residual's norm.

    The caller sets ``atol``, ``rtol`` and ``max_it``; ``petsc`` are options of the linear solver.
    ``solve(u)`` of the result returns (iterations, converged).
    """
    # Since 0.10 NonlinearProblem is an interface to SNES, and the old class has the longer name.
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
