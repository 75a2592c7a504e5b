r"""Stress of an energy in the homogeneous deformations of test data.

The principal stretches are (x, t, t) in a uniaxial, (x, x, t) in an equibiaxial and (x, 1, t) in a
planar test (pure shear). The direction of t is free of stress.

An incompressible material has the t with J = 1, and a pressure that removes the stress there:

.. math:: P = \frac{\partial\psi}{\partial s_0} - \frac{s_2}{s_0} \frac{\partial\psi}{\partial s_2}

In a compressible one t solves :math:`\partial\psi/\partial s_2 = 0`. Simple shear by gamma has the
stretches s, 1/s and 1 with s - 1/s = gamma; volumetric and confined tests have (x, x, x) and
(x, 1, 1).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: The tests with a free stretch: the principal stretches as a function of (x, t).
FREE: dict[str, Callable[[Array, Array], Array]] = {
    "uniaxial": lambda x, t: np.stack([x, t, t], axis=-1),
    "equibiaxial": lambda x, t: np.stack([x, x, t], axis=-1),
    "planar": lambda x, t: np.stack([x, np.ones_like(x), t], axis=-1),
}
#: Their derivatives by t.
_RATES = {
    "uniaxial": np.array([0.0, 1.0, 1.0]),
    "equibiaxial": np.array([0.0, 0.0, 1.0]),
    "planar": np.array([0.0, 0.0, 1.0]),
}
#: The exponent of t = x^exponent in an incompressible material.
_INCOMPRESSIBLE = {"uniaxial": -0.5, "equibiaxial": -2.0, "planar": -1.0}
#: Largest number of iterations for t, the largest step of log t and the tolerance of log t.
_ITERATIONS, _LARGEST_STEP, _TOLERANCE = 100, 0.3, 1e-13


class Law(Protocol):
    """Derivatives of an energy by the principal stretches, at some values of its parameters."""

    nu: float | None

    def stress(self, s: Array) -> Array:
        """Return dpsi/ds_i, (..., 3), of stretches (..., 3); NaN outside the energy's domain."""

    def tangent(self, s: Array) -> Array:
        """Return d2psi/ds_i ds_j, (..., 3, 3)."""


def response(law: Law, kind: str, x: Array) -> Array:
    """Return the nominal stress in a test, shape (n,); NaN where there is no solution.

    Parameters
    ----------
    law : Law
        The energy; it is incompressible if its ``nu`` is None.
    kind : str
        Key of `fem_snh.studies.fit.data.TESTS`.
    x : (n,)
        Stretches; amounts of shear of ``simple_shear``.
    """
    s = stretches(law, kind, x)
    p = law.stress(s)
    if kind == "simple_shear":  # ds_i/dgamma; no change of volume, so that no pressure works
        return (p[..., 0] * s[..., 0] ** 2 - p[..., 1]) / (s[..., 0] ** 2 + 1)
    if law.nu is None:
        return p[..., 0] - p[..., 2] * s[..., 2] / s[..., 0]
    return p[..., 0]


def stretches(law: Law, kind: str, x: Array) -> Array:
    """Return the principal stretches (n, 3) in a test."""
    if kind == "simple_shear":
        s = (x + np.sqrt(x**2 + 4)) / 2
        return np.stack([s, 1 / s, np.ones_like(s)], axis=-1)
    if kind == "volumetric":
        return np.repeat(x[:, None], 3, axis=1)
    if kind == "confined":
        return np.stack([x, np.ones_like(x), np.ones_like(x)], axis=-1)
    if law.nu is None:
        return FREE[kind](x, x ** _INCOMPRESSIBLE[kind])
    return FREE[kind](x, _free_stretch(law, kind, x))


def _free_stretch(law: Law, kind: str, x: Array) -> Array:
    """Return the t without stress, by Newton's method on log t with bisection as safeguard.

    The start is the solution for Hencky's energy, a power of x. NaN where the iteration fails, or
    ends where the stress decreases with t: that equilibrium is unstable.
    """
    assert law.nu is not None
    power = {"uniaxial": -law.nu, "equibiaxial": -2 * law.nu / (1 - law.nu)}
    log_t = power.get(kind, -law.nu / (1 - law.nu)) * np.log(x)
    low, high = np.full_like(x, -np.inf), np.full_like(x, np.inf)
    slope = np.full_like(x, np.nan)
    done = np.zeros(x.shape, dtype=bool)
    for _ in range(_ITERATIONS):
        s = FREE[kind](x, np.exp(log_t))
        with np.errstate(all="ignore"):
            value = law.stress(s)[..., 2]
            slope = law.tangent(s)[..., 2, :] @ _RATES[kind] * np.exp(log_t)
            step = -value / slope
        low = np.where(value < 0, np.maximum(low, log_t), low)
        high = np.where(value > 0, np.minimum(high, log_t), high)
        # Where the stress decreases with t, follow its sign out of there.
        wrong = ~(np.isfinite(step) & (slope > 0))
        step = np.where(wrong, np.where(value > 0, -1.0, 1.0) * _LARGEST_STEP, step)
        step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        new = log_t + step
        outside = (new <= low) | (new >= high)
        bracketed = np.isfinite(low) & np.isfinite(high)
        with np.errstate(invalid="ignore"):
            middle = (low + high) / 2
        new = np.where(outside & bracketed, middle, new)
        done = ~wrong & (np.abs(step) <= _TOLERANCE) | (value == 0)
        log_t = np.where(done, log_t, new)
        if done.all():
            break
    stable = (slope > 0) & (done | (np.abs(step) <= 1e3 * _TOLERANCE))
    return np.where(stable, np.exp(log_t), np.nan)
