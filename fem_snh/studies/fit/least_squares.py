r"""Bounded least squares of several tests at once.

.. math:: \min_{E, \theta} \sum_k \left(w_k (E \hat P(x_k; \theta) - P_k)\right)^2

The stress is proportional to E, so that the best E of given shape parameters :math:`\theta` has a
closed form; the iteration is in :math:`\theta` alone (variable projection, Golub & Pereyra 1973).
If nu is fitted, :math:`\theta` includes it. The starts are the defaults and points around them from
a fixed seed.

The weights are those of the data, but each test has a variance of its own: `standard_errors`.
Weights from the variances (iterated weights, or the likelihood concentrated in the parameters) are
not used: if no material fits two tests, as of two specimens, that likelihood is unbounded, and only
one test counts (Bates & Watts 1988, section 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from fem_snh.arrays import Array
from fem_snh.errors import BadInput
from fem_snh.studies.fit.data import TestData
from fem_snh.studies.fit.family import Family, Unknown
from fem_snh.studies.fit.responses import response

Mask = npt.NDArray[np.bool_]

#: Tolerance of scipy's least squares, and its largest number of iterations from a start.
_TOLERANCE, _ITERATIONS = 1e-10, 200
#: Starts for each shape parameter, and their largest number.
_STARTS, _MOST_STARTS = 3, 12
#: A start is the default times exp of a normal number of this standard deviation; if the default is
#: 0, it is the number itself.
_SPREAD = 0.7
#: The search ends after this many starts with the same smallest sum of squares, to this relative
#: difference.
_AGREEING, _SAME = 2, 1e-4
#: First Poisson's ratio if it is fitted.
NU_START = 0.45
#: Bounds of log(1 - 2 nu): nu from -0.9 to 0.5 - 1e-9.
_NU_BOUNDS = (np.log(2e-9), np.log(2.8))
#: The residual of a stress that has no value, in multiples of the largest measured stress.
_PENALTY = 1e2
#: Relative errors refer to at least this fraction of a test's largest stress: a measured 0 has some
#: error.
_FLOOR = 0.05
#: Smallest factor of a parameter of one sign, relative to its start.
_SMALLEST = 1e-12
#: Relative step of the central differences for the standard errors: the cube root of rounding.
_STEP = 6e-6
#: Singular values of the Jacobian below this fraction of the largest count as 0.
_RANK = 1e-9
#: Fewest degrees of freedom that a test's residuals leave for a variance of its own.
_OWN_VARIANCE = 0.5


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
        fitted, nu; infinite if the data do not determine the parameter, NaN at its bound.
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
    """The residuals of a family of energies, as functions of scaled variables z.

    These are theta/start, or log(theta/start) if theta keeps its sign, and log(1 - 2 nu) if nu is
    fitted.
    """

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
        self.group = np.repeat(np.arange(len(tests)), [len(test.x) for test in tests])
        self.penalty = _PENALTY * float(np.abs(self.measured).max())
        self.unknowns = family.unknowns
        self.one_sign = np.array([_one_sign(u) for u in self.unknowns], dtype=bool)
        self.scale = np.array([u.start or 1.0 for u in self.unknowns])
        self.evaluations = 0

    def bounds(self) -> tuple[Array, Array]:
        """Return the lower and upper bounds of the variables z."""
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
        first = np.where(self.one_sign, 0.0, [1.0 if u.start else 0.0 for u in self.unknowns])
        last = [np.log(1 - 2 * NU_START)] if self.fit_nu else []
        rng = np.random.default_rng(0)
        points = [first]
        for _ in range(min(_STARTS * count, _MOST_STARTS)):
            draw = rng.normal(0.0, _SPREAD, count)
            points.append(np.where(self.one_sign | (first == 0), draw, np.exp(draw)))
        # scipy starts inside the bounds.
        margin = 1e-6 * (1 + np.abs(np.concatenate([first, last])))
        return [np.clip(np.concatenate([p, last]), low + margin, high - margin) for p in points]

    def theta(self, z: Array) -> Array:
        """Return the shape parameters at the variables z."""
        z = z[: len(self.scale)]
        with np.errstate(over="ignore"):
            return self.scale * np.where(self.one_sign, np.exp(np.minimum(z, 700.0)), z)

    def ratio(self, z: Array) -> float | None:
        """Return Poisson's ratio at z; None for an incompressible material."""
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

    def parameters(self, z: Array) -> Array:
        """Return E, the shape parameters (constants in the unit of E) and, if it is fitted, nu."""
        theta, nu = self.theta(z), self.ratio(z)
        E = self.modulus(np.concatenate(self.predict(theta, nu)))
        return np.array([E, *theta * self.sizes(E), *([nu] if self.fit_nu else [])], dtype=float)

    def sizes(self, E: float) -> Array:
        """Return the units of the shape parameters: E of constants, else 1."""
        return np.array([E if u.constant else 1.0 for u in self.unknowns])

    def split(self, p: Array) -> tuple[Array, float | None]:
        """Return the shape parameters in ``p``, constants in units of E, and nu."""
        with np.errstate(invalid="ignore"):  # E = 0: no parameters fit
            theta = p[1 : 1 + len(self.unknowns)] / self.sizes(p[0])
        return theta, float(p[-1]) if self.fit_nu else self.nu

    def limits(self, p: Array) -> tuple[Array, Array]:
        """Return the lower and upper bounds of parameters at the E in ``p``."""
        pairs = [(-np.inf, np.inf)]
        for u, size in zip(self.unknowns, self.sizes(p[0]), strict=True):
            pairs.append((size * u.low, size * u.high))
        if self.fit_nu:
            pairs.append(tuple((1 - np.exp(z)) / 2 for z in _NU_BOUNDS[::-1]))
        low, high = np.array(pairs).T
        return low, high

    def residual(self, z: Array) -> Array:
        """Return the weighted residuals at the best E; a penalty replaces a missing stress."""
        predicted = np.concatenate(self.predict(self.theta(z), self.ratio(z)))
        with np.errstate(all="ignore"):
            difference = self.modulus(predicted) * predicted - self.measured
        return self.weight * np.where(np.isfinite(difference), difference, self.penalty)

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives of the residuals by the parameters: central differences."""
        theta = np.abs(self.split(p)[0])
        sizes = np.where(theta > 0, theta, np.abs(self.scale)) * self.sizes(p[0])
        gap = [0.5 - p[-1]] if self.fit_nu else []
        low, high = self.limits(p)
        columns = []
        for k, size in enumerate([p[0], *sizes, *gap]):
            above, below = p.copy(), p.copy()
            above[k] = min(p[k] + _STEP * size, high[k])
            below[k] = max(p[k] - _STEP * size, low[k])
            sides = [q[0] * np.concatenate(self.predict(*self.split(q))) for q in (above, below)]
            columns.append((sides[0] - sides[1]) / (above[k] - below[k]))
        return np.asarray(np.stack(columns, axis=1) * self.weight[:, None])


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
        Poisson's ratio; None for an incompressible material.
    relative : bool
        Whether the residuals are divided by the measured stresses.
    fit_nu : bool
        Whether nu is fitted, too.

    Raises
    ------
    BadInput
        If there are fewer points than unknowns, or no start has a stress at all points.
    """
    problem = _Problem(family, tests, nu, relative, fit_nu)
    count = 1 + len(family.unknowns) + fit_nu
    points = len(problem.measured)
    if points < count:
        raise BadInput(
            f"material '{family.name}': {points} points for {count} unknowns: expected more "
            "points, or fewer parameters"
        )
    z, used = _search(problem)
    p, residual = problem.parameters(z), problem.residual(z)
    theta, ratio = problem.split(p)
    predicted = problem.predict(theta, ratio)
    known = p[0] > 0 and all(np.isfinite(stress).all() for stress in predicted)
    # Infinite derivatives: the fit is at the end of the energy's domain.
    if not known or not np.isfinite(jacobian := problem.jacobian(p)).all():
        raise BadInput(
            f"material '{family.name}': no fit has a stress at all measured stretches: expected "
            "another material, or other values of its parameters"
        )
    at_bound = reaches_bound(jacobian, residual, *(limit - p for limit in problem.limits(p)))
    return BestFit(
        float(p[0]),
        0.5 if ratio is None else ratio,
        theta,
        standard_errors(jacobian, residual, problem.group, at_bound),
        [p[0] * stress for stress in predicted],
        float(residual @ residual),
        problem.evaluations,
        used,
    )


def _search(problem: _Problem) -> tuple[Array, int]:
    """Return the best variables z, and the number of starts that were used."""
    starts = problem.starts()
    if not starts[0].size:
        return starts[0], 1
    size = float(np.linalg.norm(problem.weight * problem.measured))  # gtol is no relative one
    best: tuple[float, Array] | None = None
    agreeing = 0
    for used, start in enumerate(starts, start=1):
        found = least_squares(
            lambda z: problem.residual(z) / size, start, bounds=problem.bounds(), x_scale="jac",
            max_nfev=_ITERATIONS, ftol=_TOLERANCE, xtol=_TOLERANCE, gtol=_TOLERANCE,
        )  # fmt: skip
        if best is not None and abs(found.cost - best[0]) <= _SAME * best[0]:
            agreeing += 1
        elif best is None or found.cost < best[0]:
            agreeing = 1
        if best is None or found.cost < best[0]:
            best = found.cost, found.x
        if agreeing >= _AGREEING:
            break
    assert best is not None
    return best[1], used


def _factors(jacobian: Array) -> tuple[Array, Array, Array]:
    """Return U and S^-1 V^T/d for S > 0, and V^T for S = 0, where J = U S V^T diag(d).

    The columns of J have the lengths d.
    """
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0, size, 1.0)
    left, values, rows = np.linalg.svd(jacobian / size, full_matrices=False)
    shown = values > _RANK * values.max(initial=0.0)
    return left[:, shown], rows[shown] / values[shown, None] / size, rows[~shown]


def reaches_bound(jacobian: Array, residual: Array, low: Array, high: Array) -> Mask:
    """Return a mask (k,) of the parameters whose Gauss-Newton step would cross a bound.

    Parameters
    ----------
    jacobian : (n, k)
        Derivatives of the residuals by the parameters at the solution.
    residual : (n,)
        The residuals.
    low, high : (k,)
        Bounds minus parameters.
    """
    bound = np.zeros(len(low), dtype=bool)
    while not bound.all():
        left, inverse, _ = _factors(jacobian[:, ~bound])
        step = np.zeros(len(low))
        step[~bound] = -(left.T @ residual) @ inverse
        room = np.where(step < 0, low, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = np.where(room == 0, np.inf, step / room)
        beyond[bound] = 0.0
        if not (worst := beyond.max()) >= 1:
            break
        bound |= beyond == worst  # without it the others may remain
    return bound


def standard_errors(jacobian: Array, residual: Array, group: Array, bound: Mask) -> Array:
    r"""Return the standard errors of parameters of least squares, each group with its variance.

    .. math:: C = (J^T J)^{-1} \Big(\sum_g \sigma_g^2 J_g^T J_g\Big) (J^T J)^{-1}

    is the covariance of least squares whose weights need not be the inverse of the variances
    (White 1980). With the projection H = J (J^T J)^-1 J^T and the sum of squares S_g,

    .. math:: \sigma_g^2 = S_g / (n_g - \operatorname{tr} H_{gg})

    is exact if the variances are equal, and almost unbiased otherwise (Horn, Horn & Duncan 1975). A
    group whose residuals leave less than half a degree of freedom has the variance of all.

    Parameters
    ----------
    jacobian : (n, k)
        Derivatives of the residuals by the parameters at the solution.
    residual : (n,)
        The residuals.
    group : (n,) int
        The group of each residual, from 0: a test, or a goal.
    bound : (k,)
        Whether a parameter is at a bound; its error is NaN.

    Returns
    -------
    (k,)
        Infinite where the columns of J are dependent, or there are no more residuals than
        parameters.
    """
    n, k = jacobian.shape
    errors = np.full(k, np.nan)
    if n <= k:
        errors[~bound] = np.inf
    elif not bound.all():
        left, inverse, hidden = _factors(jacobian[:, ~bound])
        of_groups = [left[group == g] for g in range(group.max() + 1)]
        squares = np.array([block.T @ block for block in of_groups])
        sums = np.bincount(group, residual**2)
        freedom = np.bincount(group) - np.trace(squares, axis1=1, axis2=2)
        own = freedom >= _OWN_VARIANCE
        variance = np.where(own, sums / np.where(own, freedom, 1.0), sums.sum() / freedom.sum())
        covariance = inverse.T @ np.tensordot(variance, squares, 1) @ inverse
        not_shown = (np.abs(hidden) > np.sqrt(_RANK)).any(axis=0)
        errors[~bound] = np.where(not_shown, np.inf, np.sqrt(np.diag(covariance)))
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
