"""Reference solutions of a study: Richardson extrapolation, checked by a second element.

A quantity on meshes of size h is q + C h^p + ..., so three meshes determine q, C and p. The error
of the extrapolated value is estimated from its change with one mesh less, and from the difference
to the value of another element.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.elements import ELEMENTS

Vector = npt.NDArray[np.float64]

#: Accepted orders: from about 1 (a singular corner) to 4 (the energy of a quadratic element).
_ORDERS = (0.8, 4.0)
#: Lower bound of the error of an extrapolated value, as a fraction of its step.
_GAIN = 0.1
#: Ratio of an error to that of the reference from which it is reported.
MARGIN = 10.0

#: Elements that do not lock and converge fast enough to be extrapolated.
LOCKING_FREE = tuple(e.name for e in ELEMENTS.values() if e.degree > 1 and e.volume != "pointwise")
CANDIDATES = " or ".join((", ".join(LOCKING_FREE[:-1]), LOCKING_FREE[-1]))
#: Meshes from which a value is extrapolated.
MESHES = 3


@dataclass(frozen=True)
class ReferenceValue:
    """The reference value of a quantity.

    Parameters
    ----------
    value : (n,) array
        Components.
    error : float
        Estimated error, relative to the norm of the value.
    step : float
        Difference of the value to that of the finest mesh, relative.
    element, finest : str
        The element and its finest mesh.
    order : float
        Observed order of convergence; NaN if the differences do not decrease.
    checked : str
        The other element that it was compared with; "" without one.
    """

    value: Vector
    error: float
    step: float
    element: str
    finest: str
    order: float
    checked: str = ""

    @property
    def floor(self) -> float:
        """Return the smallest relative error that this reference can resolve."""
        return MARGIN * self.error

    def error_of(self, value: Vector) -> float:
        """Return the error of another value, relative to the norm of this one."""
        return norm(value - self.value) / norm(self.value)


def norm(value: Vector) -> float:
    """Return the Euclidean norm."""
    return float(np.linalg.norm(value))


def observed_order(h: Sequence[float], values: Sequence[Vector]) -> float:
    """Return the p > 0 of q + C h^p through three meshes, h decreasing; NaN without one."""
    before, after = norm(values[0] - values[1]), norm(values[1] - values[2])
    if not (before > 0 and after > 0):
        return float("nan")
    from scipy.optimize import brentq

    def excess(p: float) -> float:
        return (h[0] ** p - h[1] ** p) * after - (h[1] ** p - h[2] ** p) * before

    low, high = 1e-3, 12.0
    if not excess(low) < 0 < excess(high):
        return float("nan")
    return float(brentq(excess, low, high))


def extrapolate(h: Sequence[float], values: Sequence[Vector]) -> tuple[Vector, float]:
    """Return the limit h -> 0 from the last three meshes, and the order.

    An order above the accepted ones is coincidence and is replaced by the highest accepted one.
    Below the accepted orders the values do not converge yet: the finest value and NaN are returned.
    """
    p = observed_order(h[-3:], values[-3:])
    if not p >= _ORDERS[0]:
        return values[-1], float("nan")
    ratio = (h[-2] / h[-1]) ** min(p, _ORDERS[1])
    return values[-1] + (values[-1] - values[-2]) / (ratio - 1), p


def estimate(
    element: str, finest: str, h: Sequence[float], values: Sequence[Vector]
) -> ReferenceValue | None:
    """Return the reference from the meshes of one element, h decreasing; None for fewer than three.

    With four meshes the error is the difference to the limit of the three coarser ones. It is at
    most the difference to the value of the third-finest mesh, and at least a tenth of the step from
    the finest mesh to the limit. With three meshes it is that step; without an observed order, the
    larger of the last two differences.
    """
    if len(values) < MESHES:
        return None
    kept = mesh_sequence(h)
    h, values = [h[i] for i in kept], [values[i] for i in kept]
    value, order = extrapolate(h, values)
    step = norm(value - values[-1])
    if np.isnan(order):
        error = step = max(norm(values[-1] - values[-2]), norm(values[-2] - values[-3]))
    elif len(values) == 3:
        error = step
    else:
        change = norm(value - extrapolate(h[:-1], values[:-1])[0])
        error = max(min(change, norm(value - values[-3])), _GAIN * step)
    size = norm(value)
    if not size > 0:
        return None
    return ReferenceValue(value, error / size, step / size, element, finest, order)


def mesh_sequence(h: Sequence[float]) -> list[int]:
    """Return the meshes to extrapolate from: four or more, each twice as fine, otherwise all."""
    kept = [len(h) - 1]
    for i in reversed(range(len(h) - 1)):
        if h[i] >= 1.9 * h[kept[0]]:
            kept.insert(0, i)
    return kept if len(kept) > 3 else list(range(len(h)))


def establish(candidates: Sequence[ReferenceValue]) -> ReferenceValue | None:
    """Return the candidate whose finest mesh is nearest to its limit; None without candidates.

    The next candidate checks it if its own error is below 0.1. The error of the first is increased
    by the part of their difference that exceeds the error of the second.
    """
    if not candidates:
        return None
    best, *others = sorted(candidates, key=lambda found: found.step)
    if not others:
        return best
    other = others[0]
    error = max(best.error, best.error_of(other.value) - other.error)
    return replace(best, error=error, checked=other.element if other.error <= 0.1 else "")


def reference_message(
    name: str, found: ReferenceValue | None, measured: Mapping[str, float]
) -> str:
    """Return a line about the reference of a quantity and the errors measured with it."""
    if found is None:
        return f"{name}: no reference: needs {CANDIDATES} on three meshes; no errors"
    order = "no order" if np.isnan(found.order) else f"order {found.order:.2f}"
    check = f", checked by {found.checked}" if found.checked else ", not checked by another element"
    words = f"{name}: {found.element} up to {found.finest} ({order}{check}), own error "
    words += f"{100 * found.error:.2g} %"
    largest = max(measured.values(), default=0.0)
    if not found.floor < largest:
        return f"{words}: rejected, no measured error is ten times larger; no errors"
    return f"{words}: resolves errors above {100 * found.floor:.2g} %"
