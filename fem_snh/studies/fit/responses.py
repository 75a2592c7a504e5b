r"""Stress and stability of an energy in the homogeneous deformations of test data.

Indices start at 0. The principal stretches of a biaxial test are (x, y, t); y is x in an
equibiaxial and 1 in a planar test (pure shear). A uniaxial test has (x, t, t). The direction of t
is free of stress.

An incompressible material has the t with J = 1, and a pressure that removes the stress there:

.. math::

    P_i = \frac{\partial\psi}{\partial s_i}
    - \frac{s_2}{s_i} \frac{\partial\psi}{\partial s_2}

The difference of the true stresses :math:`\sigma_i = s_i P_i/J` does not depend on the pressure.
In a compressible material t solves :math:`\partial\psi/\partial s_2 = 0`. Simple shear by gamma
has the stretches s, 1/s and 1 with s - 1/s = gamma; volumetric and confined tests have (x, x, x)
and (x, 1, 1).

Stable ranges of a fit along the three tests with free sides follow from Drucker's criterion, which
finite-element programs apply to fits: Kirchhoff's stress
:math:`\tau_i = \partial\psi/\partial\varepsilon_i` increases with the logarithmic strains
:math:`\varepsilon_i = \log s_i`, :math:`d\tau : d\varepsilon > 0`, for all changes of the
principal stretches, which for an incompressible material keep the volume:

.. math::

    \sum_{ij} d\varepsilon_i \left(s_i \frac{\partial^2\psi}{\partial s_i \partial s_j} s_j
    + \delta_{ij} s_i \frac{\partial\psi}{\partial s_i}\right) d\varepsilon_j > 0
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fem_snh.arrays import Array

if TYPE_CHECKING:
    from fem_snh.studies.fit.family import Member

#: The tests with a free stretch and one independent stretch; `biaxial` has two.
FREE = ("uniaxial", "equibiaxial", "planar")
#: The stresses that may be measured in a biaxial test; other tests measure the first.
MEASURES = ("stress", "stress_2", "stress_difference")
#: Largest number of iterations for t, the largest step of log t and the tolerance of log t.
_ITERATIONS, _LARGEST_STEP, _TOLERANCE = 100, 0.3, 1e-13

#: Changes of the logarithmic strains that keep the volume, orthonormal, (2, 3).
_ISOCHORIC = np.array([[1, -1, 0], [1, 1, -2]]) / np.sqrt([[2], [6]])
#: Samples on each side of rest, and bisections of the ends of a stable range.
_SAMPLES, _BISECTIONS = 120, 30


def response(
    law: Member, kind: str, x: Array, stretch_2: Array | None = None, measure: str = "stress"
) -> Array:
    """Return the stress in a test, shape (n,); NaN where there is no solution.

    Parameters
    ----------
    law : Member
        The energy; it is incompressible if its ``nu`` is None.
    kind : str
        Key of `fem_snh.studies.fit.data.TESTS`.
    x : (n,)
        Stretches; amounts of shear of ``simple_shear``.
    stretch_2 : (n,)
        The second stretches of ``biaxial``.
    measure : str
        The nominal stress of direction 1 or 2, "stress" or "stress_2", or the difference of the
        true stresses of the two, "stress_difference".
    """
    s = stretches(law, kind, x, stretch_2)
    p = law.stress(s)
    if kind == "simple_shear":  # ds_i/dgamma; no change of volume, so that no pressure works
        return (p[..., 0] * s[..., 0] ** 2 - p[..., 1]) / (s[..., 0] ** 2 + 1)
    if law.nu is None:
        with np.errstate(invalid="ignore"):  # infinite stresses
            p = p - p[..., 2:] * s[..., 2:] / s
    if measure == "stress_difference":
        return (s[..., 0] * p[..., 0] - s[..., 1] * p[..., 1]) / s.prod(axis=-1)
    return p[..., 1 if measure == "stress_2" else 0]


def stretches(law: Member, kind: str, x: Array, stretch_2: Array | None = None) -> Array:
    """Return the principal stretches (n, 3) in a test; NaN where no free stretch is found."""
    if kind == "simple_shear":
        s = (x + np.sqrt(x**2 + 4)) / 2
        return np.stack([s, 1 / s, np.ones_like(s)], axis=-1)
    if kind == "volumetric":
        return np.repeat(x[:, None], 3, axis=1)
    if kind == "confined":
        return np.stack([x, np.ones_like(x), np.ones_like(x)], axis=-1)
    second = {"uniaxial": None, "equibiaxial": x, "planar": np.ones_like(x), "biaxial": stretch_2}
    y = second[kind]
    if law.nu is not None:
        t = _free_stretch(law, x, y)
    else:
        t = x**-0.5 if y is None else 1 / (x * y)
    return _principal(x, y, t)


def _principal(x: Array, y: Array | None, t: Array) -> Array:
    """Return the principal stretches (x, y, t), (n, 3); y = t if None."""
    return np.stack([x, t if y is None else y, t], axis=-1)


def _free_stretch(law: Member, x: Array, y: Array | None) -> Array:
    """Return the t (n,) without stress, by Newton's method on log t with bisection as safeguard.

    The start is the solution for Hencky's energy. NaN where the iteration fails, or ends where the
    stress decreases with t: that equilibrium is unstable.
    """
    assert law.nu is not None
    rates = np.array([0.0, y is None, 1.0])  # of the stretches by t
    log_t = -law.nu * np.log(x) if y is None else -law.nu / (1 - law.nu) * np.log(x * y)
    low, high = np.full_like(x, -np.inf), np.full_like(x, np.inf)
    slope = np.full_like(x, np.nan)
    done = np.zeros(x.shape, dtype=bool)
    for _ in range(_ITERATIONS):
        s = _principal(x, y, np.exp(log_t))
        with np.errstate(all="ignore"):
            value = law.stress(s)[..., 2]
            slope = law.tangent(s)[..., 2, :] @ rates * np.exp(log_t)
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


@dataclass(frozen=True)
class StableRange:
    """The stretches around rest in which a material is stable in one test.

    Attributes
    ----------
    kind : str
        The test.
    low, high : float
        Ends of the stable range.
    searched : (float, float)
        The searched range; a stable range that ends there may extend further.
    """

    kind: str
    low: float
    high: float
    searched: tuple[float, float]

    @property
    def whole(self) -> bool:
        """Return whether all of the searched range is stable."""
        return (self.low, self.high) == self.searched


def stable_ranges(law: Member, low: float, high: float) -> tuple[StableRange, ...]:
    """Return the stable ranges of the uniaxial, the equibiaxial and the planar test.

    Parameters
    ----------
    law : Member
        The energy.
    low, high : float
        The range of stretches that is searched, around 1.
    """
    return tuple(
        StableRange(kind, _end(law, kind, low), _end(law, kind, high), (low, high)) for kind in FREE
    )


def stable_at(law: Member, kind: str, x: Array, stretch_2: Array | None = None) -> bool:
    """Return whether a material is stable at the data of a test by Drucker's criterion.

    A biaxial test is examined at its points (n,), another test from rest to its extreme stretches.
    """
    if kind == "biaxial":
        return bool((smallest_stiffness(law, kind, x, stretch_2) > 0).all())
    return all(_end(law, kind, end) == end for end in (min(1.0, *x), max(1.0, *x)))


def smallest_stiffness(law: Member, kind: str, x: Array, stretch_2: Array | None = None) -> Array:
    """Return the smallest eigenvalue of Drucker's quadratic form, (n,); NaN without a stress."""
    s = stretches(law, kind, x, stretch_2)
    stress, A = law.stress(s), law.tangent(s)
    with np.errstate(invalid="ignore"):  # infinite stresses
        A = np.einsum("ni,nij,nj->nij", s, (A + np.swapaxes(A, -1, -2)) / 2, s)
        A[:, range(3), range(3)] += s * stress
    finite: Array = np.isfinite(A).all(axis=(-1, -2))
    finite &= np.isfinite(response(law, kind, x, stretch_2))
    A = np.where(finite[:, None, None], A, 0.0)
    if law.nu is None:
        A = _ISOCHORIC @ A @ _ISOCHORIC.T
    return np.where(finite, np.linalg.eigvalsh(A)[:, 0], np.nan)


def _end(law: Member, kind: str, end: float) -> float:
    """Return the end of the stable range from 1 towards ``end``."""
    if end == 1.0:
        return 1.0
    x: Array = np.asarray(np.geomspace(1.0, end, _SAMPLES + 1), dtype=np.float64)
    unstable = ~(smallest_stiffness(law, kind, x) > 0)
    if not unstable.any():
        return end
    first = int(np.argmax(unstable))
    if first == 0:
        return 1.0
    good, bad = x[first - 1], x[first]
    for _ in range(_BISECTIONS):
        middle = np.sqrt(good * bad)
        if smallest_stiffness(law, kind, np.array([middle]))[0] > 0:
            good = middle
        else:
            bad = middle
    return float(good)
