"""Compare the residual and the Hessian of a problem with central differences."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from fem_snh import _dolfinx
from fem_snh.assembly.unknowns import add_ghosts, update_ghosts


def check_derivatives(
    problem: Any,
    dofs: Iterable[int],
    h: float,
    slopes: float,
    columns: float,
    constrained: bool = True,
) -> None:
    """Assert that the residual is the derivative of the energy, and the exact Hessian its own.

    ``slopes`` and ``columns`` bound the errors, relative to the largest entry. Without the
    ``constrained`` dofs, the forces and the rows of the Hessian are those of the free ones.
    """
    forces = problem.residual if constrained else problem.gradient
    r, high, low, x = (problem.x.duplicate() for _ in range(4))
    forces(problem.x, r)
    problem.jacobian(problem.x, "exact")
    rows = np.arange(len(r.array))
    if not constrained:
        rows = np.setdiff1d(rows, problem.constrained_dofs)
        dofs = np.intersect1d(rows, list(dofs))
    for dof in dofs:
        energies = []
        for sign, force in ((1, high), (-1, low)):
            problem.x.copy(x)
            x.array[dof] += sign * h
            energies.append(problem.energy(x))
            forces(x, force)
        slope = (energies[0] - energies[1]) / (2 * h)
        assert slope == pytest.approx(r.array[dof], abs=slopes * abs(r.array).max())
        column = ((high.array - low.array) / (2 * h))[rows]
        exact = problem.A.getColumnVector(int(dof)).array[rows]
        assert abs(column - exact).max() < columns * abs(exact).max()


def differences(term: Any, V: Any, u: Any, d: Any, h: float) -> tuple[float, Any, Any]:
    """Return the slope of a term's energy along a step, its forces, and their derivative.

    ``u`` and ``d`` are a displacement and a step, vectors of V; the derivatives are central
    differences.
    """

    def moved(size: float) -> Any:
        x = u.copy()
        x.axpy(size, d)
        update_ghosts(x)
        return x

    def forces(x: Any) -> Any:
        r = _dolfinx.create_vector(V)
        term.add_residual(x, None, r, None)
        add_ghosts(r)
        return r

    ends = moved(h), moved(-h)
    change = forces(ends[0]) - forces(ends[1])
    change.scale(1 / (2 * h))
    return (term.energy(ends[0]) - term.energy(ends[1])) / (2 * h), forces(u), change
