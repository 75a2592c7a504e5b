"""Energy and stress as an element collapses (J -> 0) and inverts; a part of the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_snh.kernels.material import Material
from fem_snh.kernels.reports.evaluate import Array, diagonal, stress

#: Collapse to a plane and to a point: which stretches tend to 0.
PATHS = {"flattened (1, 1, s)": (0.0, 0.0, 1.0), "shrunk (s, s, s)": (1.0, 1.0, 1.0)}


@dataclass(frozen=True)
class Collapse:
    """Energy and stress along one of `PATHS`, through J = 0 to inverted states.

    Attributes
    ----------
    path : str
        Key of `PATHS`.
    s : numpy.ndarray
        The stretch, from -1.5 to 2.
    energy, stress : numpy.ndarray
        psi and dpsi/ds2 [Pa]; NaN where they are infinite or there is no energy.
    at_zero, stress_at_zero : float
        Limits of psi and dpsi/ds2 as s -> 0 from above [Pa]; infinite if unbounded. Where psi is
        infinite before s = 0, there is no stress: NaN.
    """

    path: str
    s: Array
    energy: Array
    stress: Array
    at_zero: float
    stress_at_zero: float


def collapses(m: Material) -> tuple[Collapse, ...]:
    """Return the collapse along both paths."""
    return tuple(collapse(m, path) for path in PATHS)


def collapse(m: Material, path: str) -> Collapse:
    """Return energy and stress along one of `PATHS`."""
    moves = np.array(PATHS[path])

    def along(s: Array) -> tuple[Array, Array]:
        stretches = np.where(moves > 0, s[:, None], 1.0)
        F = diagonal(stretches)
        psi = m.energy(F) if m.expression.has_energy else np.full(len(s), np.nan)
        return np.where(np.isfinite(psi), psi, np.nan), stress(m, stretches)[:, 2]

    s = np.linspace(-1.5, 2, 281)
    near = along(np.array([1e-2, 1e-5, 1e-8]))
    outside = m.expression.has_energy and np.isnan(near[0]).any()
    limits = (np.inf, np.nan) if outside else (_limit(near[0]), _limit(near[1]))
    return Collapse(path, s, *along(s), *limits)


def _limit(values: Array) -> float:
    """Return the limit of values at s = 1e-2, 1e-5, 1e-8; infinite if the last change is large.

    From the first interval to the second the change of a logarithm is the same, that of a
    convergent sequence about 1000 times smaller.
    """
    first, last = values[1] - values[0], values[2] - values[1]
    if abs(last) > 0.3 * abs(first) and abs(last) > 1e-6 * abs(values[2]):
        return float(np.copysign(np.inf, last))
    return float(values[2])
