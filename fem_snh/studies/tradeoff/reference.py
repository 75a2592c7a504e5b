"""The reference of a study, out of its own rows: refined meshes, extrapolated, cross-checked.

A quantity of an element on meshes of width h is q + C h^p + ..., so three meshes tell q, C and p
(Richardson). What comes out is trusted only as far as it agrees with what one mesh less says, and
with what another element says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fem_snh.fem.elements import ELEMENTS

Vector = npt.NDArray[np.float64]

#: Orders that are believed: a corner's singularity, about 1, up to what a quadratic element can do.
_ORDERS = (0.8, 4.0)
#: An extrapolation is not believed to be better than this part of its step.
_GAIN = 0.1
#: An error must be this many times the reference's own, to be told.
MARGIN = 10.0

#: What does not lock, and is of an order worth extrapolating.
FREE = tuple(e.name for e in ELEMENTS.values() if e.degree > 1 and e.volume != "pointwise")
CANDIDATES = " or ".join((", ".join(FREE[:-1]), FREE[-1]))


@dataclass(frozen=True)
class Reference:
    """What a quantity is, as far as the study knows.

    Attributes:
        value: (n,) its components.
        error: of the value, relative to its norm: estimated, not bounded.
        step: from the finest mesh to the value, relative.
        element, finest: whose rows it comes from, and the finest of its meshes.
        order: that was observed; NaN if the differences do not fall.
        checked: the other element that it was compared with; "" if there is none.
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
        """The smallest error, relative, that this reference can tell."""
        return MARGIN * self.error

    def error_of(self, value: Vector) -> float:
        """The error of another value, relative to the norm of this one."""
        return norm(value - self.value) / norm(self.value)


def norm(value: Vector) -> float:
    """Its Euclidean norm."""
    return float(np.linalg.norm(value))


def observed_order(h: Sequence[float], values: Sequence[Vector]) -> float:
    """The p > 0 of q + C h^p through three meshes, h falling; NaN where there is none."""
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
    """The limit h -> 0 by the last three of the meshes, and the order; no order, the last value.

    An order above what the element can do is chance: it is taken for the highest believed. One
    below what any corner makes is no convergence yet: the finest value is not improved.
    """
    p = observed_order(h[-3:], values[-3:])
    if not p >= _ORDERS[0]:
        return values[-1], float("nan")
    ratio = (h[-2] / h[-1]) ** min(p, _ORDERS[1])
    return values[-1] + (values[-1] - values[-2]) / (ratio - 1), p


def estimate(
    element: str, finest: str, h: Sequence[float], values: Sequence[Vector]
) -> Reference | None:
    """The limit of one element's meshes, h falling; None for fewer than three.

    With four meshes its error is the difference to the limit from all but the finest, which may
    itself be far off: at most that to the mesh before the last two, at least a tenth of the step
    from the finest. With three meshes, all of that step; where no order is seen, the larger of the
    last two differences.
    """
    if len(values) < 3:
        return None
    kept = spread(h)
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
    return Reference(value, error / size, step / size, element, finest, order)


def spread(h: Sequence[float]) -> list[int]:
    """Which of the meshes to extrapolate from: if four are left, each twice as fine as the last."""
    kept = [len(h) - 1]
    for i in reversed(range(len(h) - 1)):
        if h[i] >= 1.9 * h[kept[0]]:
            kept.insert(0, i)
    return kept if len(kept) > 3 else list(range(len(h)))


def establish(candidates: Sequence[Reference]) -> Reference | None:
    """The one whose finest mesh is nearest to its limit; None without any.

    The next one may raise its error: where they differ by more than the second admits, the rest is
    the first one's. One that does not know itself to a tenth has checked nothing.
    """
    if not candidates:
        return None
    best, *others = sorted(candidates, key=lambda found: found.step)
    if not others:
        return best
    other = others[0]
    error = max(best.error, best.error_of(other.value) - other.error)
    return replace(best, error=error, checked=other.element if other.error <= 0.1 else "")


def say(name: str, found: Reference | None, measured: Mapping[str, float]) -> str:
    """One line about a quantity's reference, with the errors that were measured by it."""
    if found is None:
        return f"{name}: no reference: {CANDIDATES} on three meshes would make one; no errors"
    order = "no order" if np.isnan(found.order) else f"order {found.order:.2f}"
    check = f", checked by {found.checked}" if found.checked else ", not checked by another element"
    words = f"{name}: {found.element} up to {found.finest} ({order}{check}), own error "
    words += f"{100 * found.error:.2g} %"
    largest = max(measured.values(), default=0.0)
    if not found.floor < largest:
        return f"{words}: refused, no error measured is ten times that; no errors"
    return f"{words}: tells errors above {100 * found.floor:.2g} %"
