"""What happens as an element is crushed, and beyond: psi as J -> 0 and under inversion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_snh.kernels.pointwise import Material
from fem_snh.reports.evaluate import Array, diagonal, stress

#: How an element is crushed: to a plane, to a point.
PATHS = {"flattened (1, 1, s)": (0.0, 0.0, 1.0), "shrunk (s, s, s)": (1.0, 1.0, 1.0)}


@dataclass(frozen=True)
class Collapse:
    """An element crushed along one of `PATHS`, through 0 and inverted.

    s : from -1.5 to 2.
    energy : psi [Pa], NaN where it is infinite (everywhere, for a material that has none).
    stress : dpsi/ds2 [Pa] likewise.
    at_zero : psi as s -> 0 from above [Pa], +-inf where it has no bound; NaN without energy.
    stress_at_zero : dpsi/ds2 there [Pa].
    """

    path: str
    s: Array
    energy: Array
    stress: Array
    at_zero: float
    stress_at_zero: float


def collapses(m: Material) -> tuple[Collapse, ...]:
    """Both paths."""
    return tuple(collapse(m, path) for path in PATHS)


def collapse(m: Material, path: str) -> Collapse:
    """Energy and stress along one of `PATHS`."""
    moves = np.array(PATHS[path])

    def along(s: Array) -> tuple[Array, Array]:
        stretches = np.where(moves > 0, s[:, None], 1.0)
        F = diagonal(stretches)
        psi = m.energy(F) if m.expression.has_energy else np.full(len(s), np.nan)
        return np.where(np.isfinite(psi), psi, np.nan), stress(m, stretches)[:, 2]

    s = np.linspace(-1.5, 2, 281)
    near = along(np.array([1e-2, 1e-5, 1e-8]))
    return Collapse(path, s, *along(s), _limit(near[0]), _limit(near[1]))


def _limit(values: Array) -> float:
    """The limit of a sequence at 1e-2, 1e-5, 1e-8: infinite if its last change is not small.

    A logarithm changes as much each time; what has a limit, a thousand times less or so.
    """
    first, last = values[1] - values[0], values[2] - values[1]
    if abs(last) > 0.3 * abs(first) and abs(last) > 1e-6 * abs(values[2]):
        return float(np.copysign(np.inf, last))
    return float(values[2])
