r"""Bounded least squares of several tests at once.

.. math:: \min_{E, \theta} \sum_k \left(w_k (E \hat P(x_k; \theta) - P_k)\right)^2

The stress is proportional to E, so that the best E of given shape parameters :math:`\theta` has a
closed form; the iteration is in :math:`\theta` alone (variable projection, Golub & Pereyra 1973).
If the data show it, Poisson's ratio is one of them. The starts are the defaults and points around
them from a fixed seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from fem_snh.errors import BadInput
from fem_snh.studies.fit.data import TestData
from fem_snh.studies.fit.family import Family, Unknown
from fem_snh.studies.fit.responses import response

Array = npt.NDArray[np.float64]

#: Tolerance of scipy's least squares, and its largest number of iterations from a start.
_TOLERANCE, _ITERATIONS = 1e-10, 200
#: Starts for each shape parameter, and their largest number.
_STARTS, _MOST_STARTS = 3, 12
#: The factors of the starts are exp of normal numbers of this deviation; parameters of start 0 get
#: the numbers themselves.
_SPREAD = 0.7
#: The search ends after this many starts with the same smallest sum of squares, to this relative
#: difference.
_AGREEING, _SAME = 2, 1e-4
#: First Poisson's ratio where it is an unknown; it remains above -1 and below 0.5.
_NU_START = 0.45
#: Bounds of log(1 - 2 nu): nu from -0.9 to 0.5 - 1e-9.
_NU_BOUNDS = (np.log(2e-9), np.log(2.8))
#: A stress that has no value counts as this many times the largest measured one.
_PENALTY = 1e2
#: Stresses below this part of a test's largest one have the error of that part, if errors are
#: relative: a measured 0 has some error.
_FLOOR = 0.05
#: Smallest factor of a parameter of one sign, relative to its start.
_SMALLEST = 1e-12
#: Step of the differences for the standard errors: the cube root of the rounding error.
_STEP = 6e-6
#: Singular values of the Jacobian below this part of the largest show no parameter.
_RANK = 1e-9


@dataclass(frozen=True)
class BestFit:
    """The parameters of the smallest sum of squares.

    Attributes
    ----------
    E, nu : float
        Young's modulus [unit of the stresses] and Poisson's ratio.
    theta : (k,)
        The unknown shape parameters; constants in units of E.
    errors : (k + 1,) or (k + 2,)
        Standard errors of E, theta (of constants, in the unit of the stresses) and, if it is
        unknown, nu; infinite where the data do not show a parameter, NaN where one is at its bound.
    predicted : list of (n,)
        The stresses in each test.
    cost : float
        Weighted sum of squares.
    evaluations, starts : int
        Number of evaluations of all stresses, and of starts.
    """

    E: float
    nu: float
    theta: Array
    errors: Array
    predicted: list[Array]
    cost: float
    evaluations: int
    starts: int


class _Problem:
    """The residuals of a family of energies, in variables of size one."""

    def __init__(
        self,
        family: Family,
        tests: Sequence[TestData],
        nu: float | None,
        relative: bool,
        fit_nu: bool,
    ) -> None:
        self.family, self.tests, self.nu, self.fit_nu = family, tests, nu, fit_nu
        self.measured = np.concatenate([test.stress for test in tests])
        self.weight = np.concatenate([_weights(test, relative) for test in tests])
        self.penalty = _PENALTY * float(np.abs(self.measured).max())
        self.unknowns = family.unknowns
        self.one_sign = np.array([_one_sign(u) for u in self.unknowns], dtype=bool)
        self.scale = np.array([u.start or 1.0 for u in self.unknowns])
        self.evaluations = 0

    def bounds(self) -> tuple[Array, Array]:
        """Return the bounds of the variables."""
        both = []
        for u, s, log in zip(self.unknowns, self.scale, self.one_sign, strict=True):
            pair = sorted((u.low / s, u.high / s))
            both.append([float(np.log(max(x, _SMALLEST))) for x in pair] if log else pair)
        if self.fit_nu:
            both.append(list(_NU_BOUNDS))
        low, high = np.array(both).reshape(-1, 2).T
        return low, high

    def starts(self) -> list[Array]:
        """Return the starts, the defaults first."""
        low, high = self.bounds()
        count = len(self.unknowns)
        first = np.array(
            [0.0 if log else (1.0 if u.start else 0.0)
             for u, log in zip(self.unknowns, self.one_sign, strict=True)]
        )  # fmt: skip
        last = [np.log(1 - 2 * _NU_START)] if self.fit_nu else []
        rng = np.random.default_rng(0)
        points = [first]
        for _ in range(min(_STARTS * count, _MOST_STARTS)):
            draw = rng.normal(0.0, _SPREAD, count)
            points.append(np.where(self.one_sign | (first == 0), draw, np.exp(draw)))
        margin = 1e-6 * (
            1 + np.abs(np.concatenate([first, last]))
        )  # scipy starts inside the bounds
        return [np.clip(np.concatenate([p, last]), low + margin, high - margin) for p in points]

    def theta(self, z: Array) -> Array:
        """Return the shape parameters of the variables."""
        z = z[: len(self.scale)]
        with np.errstate(over="ignore"):
            return self.scale * np.where(self.one_sign, np.exp(np.minimum(z, 700.0)), z)

    def ratio(self, z: Array) -> float | None:
        """Return Poisson's ratio; None of an incompressible material."""
        return float(1 - np.exp(z[-1])) / 2 if self.fit_nu else self.nu

    def predict(self, theta: Array, nu: float | None) -> list[Array]:
        """Return the stresses in the tests for E = 1."""
        self.evaluations += 1
        law = self.family.at(theta, nu)
        with np.errstate(all="ignore"):
            return [response(law, t.kind, t.x, t.stretch_2, t.measure) for t in self.tests]

    def modulus(self, predicted: Array) -> float:
        """Return the best E > 0 of stresses at E = 1; 0 if there is none."""
        known = np.isfinite(predicted)
        a, b = (self.weight * predicted)[known], (self.weight * self.measured)[known]
        with np.errstate(all="ignore"):
            best = (a @ b) / (a @ a) if len(a) else 0.0
        return float(best) if np.isfinite(best) and best > 0 else 0.0

    def residual(self, z: Array) -> Array:
        """Return the weighted residuals at the best E."""
        predicted = np.concatenate(self.predict(self.theta(z), self.ratio(z)))
        with np.errstate(all="ignore"):
            difference = self.modulus(predicted) * predicted - self.measured
        return self.weight * np.where(np.isfinite(difference), difference, self.penalty)

    def jacobian(self, E: float, theta: Array, nu: float | None) -> Array:
        """Return the derivatives of the residuals by E, the parameters and log(1 - 2 nu).

        A constant that is an unknown, theta E, counts itself [units of E] and not as theta.
        """
        columns: list[Any] = [np.concatenate(self.predict(theta, nu))]
        for k, u in enumerate(self.unknowns):
            step = _STEP * (abs(theta[k]) or abs(self.scale[k]))
            ends = [min(max(theta[k] + sign * step, u.low), u.high) for sign in (1, -1)]
            slope = self._difference(E, theta, nu, k, ends)
            if u.constant:
                slope = np.asarray(slope / E, dtype=np.float64)
                columns[0] = columns[0] - theta[k] * slope
            columns.append(slope)
        if self.fit_nu and nu is not None:
            gap = 1 - 2 * nu
            ends = [0.5 - gap / 2 * np.exp(sign * _STEP) for sign in (1, -1)]
            sides = [np.concatenate(self.predict(theta, ratio)) for ratio in ends]
            columns.append(E * (sides[0] - sides[1]) / (2 * _STEP))
        return np.asarray(np.stack(columns, axis=1) * self.weight[:, None])

    def _difference(
        self, E: float, theta: Array, nu: float | None, k: int, ends: list[float]
    ) -> Array:
        sides: list[Any] = []
        for value in ends:
            moved = theta.copy()
            moved[k] = value
            sides.append(np.concatenate(self.predict(moved, nu)))
        slope: Array = E * (sides[0] - sides[1]) / (ends[0] - ends[1])
        return slope


def solve(
    family: Family,
    tests: Sequence[TestData],
    nu: float | None,
    relative: bool = False,
    fit_nu: bool = False,
) -> BestFit:
    """Return the best parameters.

    Parameters
    ----------
    family : Family
        The energies.
    tests : sequence of TestData
        The measurements.
    nu : float or None
        Poisson's ratio; None of an incompressible material.
    relative : bool
        Whether the residuals are divided by the measured stresses.
    fit_nu : bool
        Whether nu is an unknown, too.

    Raises
    ------
    BadInput
        If there are fewer points than unknowns, or no start has a stress at all points.
    """
    problem = _Problem(family, tests, nu, relative, fit_nu)
    count = 1 + len(family.unknowns) + fit_nu
    points = int(np.count_nonzero(problem.weight))
    if points < count:
        raise BadInput(
            f"material '{family.name}': {points} points for {count} unknowns: expected more "
            "points, or fewer parameters"
        )
    z, used = _search(problem)
    theta, ratio = problem.theta(z), problem.ratio(z)
    predicted = problem.predict(theta, ratio)
    E = problem.modulus(np.concatenate(predicted))
    if not E > 0 or not all(np.isfinite(stress).all() for stress in predicted):
        raise BadInput(
            f"material '{family.name}': no fit has a stress at all measured stretches: expected "
            "another material, or other values of its parameters"
        )
    low, high = problem.bounds()
    at_bound = np.concatenate([[False], _at_bound(problem, z, low, high)])
    sizes = np.array([1.0, *np.ones(len(theta)), *([0.5 - (ratio or 0.0)] if fit_nu else [])])
    cost = float((problem.residual(z) ** 2).sum())
    errors = sizes * standard_errors(problem.jacobian(E, theta, ratio), cost, at_bound)
    return BestFit(
        E,
        0.5 if ratio is None else ratio,
        theta,
        errors,
        [E * stress for stress in predicted],
        cost,
        problem.evaluations,
        used,
    )


def _search(problem: _Problem) -> tuple[Array, int]:
    """Return the best variables, and the number of starts that were needed."""
    starts = problem.starts()
    low, high = problem.bounds()
    if not len(low):
        return starts[0], 1
    best: Any = None
    agreeing = 0
    for used, start in enumerate(starts, start=1):
        found = least_squares(
            problem.residual, start, bounds=(low, high), x_scale="jac", max_nfev=_ITERATIONS,
            ftol=_TOLERANCE, xtol=_TOLERANCE, gtol=_TOLERANCE,
        )  # fmt: skip
        if best is not None and abs(found.cost - best.cost) <= _SAME * best.cost:
            agreeing += 1
        elif best is None or found.cost < best.cost:
            agreeing = 1
        if best is None or found.cost < best.cost:
            best = found
        if agreeing >= _AGREEING:
            break
    return np.asarray(best.x), used


def _at_bound(problem: _Problem, z: Array, low: Array, high: Array) -> npt.NDArray[np.bool_]:
    """Return which variables are at a bound."""
    margin = 1e-6 * (1 + np.abs(z))
    return np.asarray((z <= low + margin) | (z >= high - margin))


def standard_errors(jacobian: Array, cost: float, bound: npt.NDArray[np.bool_]) -> Array:
    """Return the standard errors of the parameters, from the Jacobian of the residuals.

    Parameters
    ----------
    jacobian : (n, k)
        Derivatives of the residuals at the solution.
    cost : float
        Sum of their squares.
    bound : (k,)
        Whether a parameter is at a bound; its error is NaN.

    Returns
    -------
    (k,)
        Roots of the diagonal of cost/(n - k) (J^T J)^-1; infinite where the columns of J are
        dependent.
    """
    n, k = jacobian.shape
    errors = np.full(k, np.nan)
    if n <= k:
        return np.where(bound, np.nan, np.inf)
    free = jacobian[:, ~bound]
    if not free.size:
        return errors
    size = np.linalg.norm(free, axis=0)
    size = np.where(size > 0, size, 1.0)
    _, values, rows = np.linalg.svd(free / size, full_matrices=False)
    shown = values > _RANK * values[0]
    variance = ((rows[shown] / values[shown, None]) ** 2).sum(axis=0)
    hidden = (np.abs(rows[~shown]) > np.sqrt(_RANK)).any(axis=0)
    errors[~bound] = np.where(hidden, np.inf, np.sqrt(cost / (n - k) * variance) / size)
    return errors


def _weights(test: TestData, relative: bool) -> Array:
    """Return the weights of a test's residuals."""
    if not relative:
        return test.weight
    size = np.abs(test.stress)
    return test.weight / np.maximum(size, _FLOOR * size.max())


def _one_sign(u: Unknown) -> bool:
    """Return whether an unknown keeps its sign: its logarithm is then the variable."""
    return u.start != 0 and (u.low >= 0 or u.high <= 0)
