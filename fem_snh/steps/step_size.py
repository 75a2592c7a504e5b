"""The size of the next load step: halved after a failure, adapted to an error estimate."""

from __future__ import annotations

from math import ceil

#: A failed step is halved at most this many times: 1/64 of a nominal step.
MAX_HALVINGS = 6
#: Relative difference from which two step sizes differ; rounding of the load is smaller.
_ROUNDING = 1e-12
#: Bounds of the factor from one adaptive step to the next, and the safety factor (Hairer, Norsett &
#: Wanner 1993, section II.4).
_LEAST, _MOST, _SAFETY = 0.2, 2.0, 0.9


class StepSize:
    """Sizes of load steps, of which every multiple of 1/steps is an end.

    A step that fails is halved; after one that converges the size doubles, up to the nominal one.
    With an error estimate, the size follows it as well.

    Parameters
    ----------
    steps : int
        Number of nominal steps.
    divisible : bool
        Whether a shorter step is tried after a failure.

    Attributes
    ----------
    next : float or None
        Size of the next step; None if it ends at the next multiple of 1/steps.
    ratio : float
        Error of the last step over its tolerance; to be set before `accept` or `reject`.
    max_divisions : int
        A nominal step is divided at most into this many.
    """

    def __init__(self, steps: int, divisible: bool = True) -> None:
        self.next: float | None = None
        self.ratio = 0.0
        self.max_divisions = 2**MAX_HALVINGS if divisible else 1
        self._shortest = 1 / (self.max_divisions * steps)
        self._size = 0.0

    def end(self, load: float, target: float) -> float:
        """Return the end of the next step from a load, which is not beyond ``target``."""
        rest = target - load
        self._size = size = self.next or rest
        # A sum of halved steps differs from the target by rounding.
        return target if size >= rest * (1 - _ROUNDING) else load + size

    def accept(self, to: float, target: float) -> None:
        """Set the size after a step to ``to`` that converged."""
        self.next = None if to == target else 2 * self._size

    @property
    def is_divisible(self) -> bool:
        """Whether the present step may be tried in halves."""
        return self._size > self._shortest * 1.5

    def reject(self, load: float, to: float) -> bool:
        """Set the size after a step that failed; return whether one so short may be tried."""
        self.next = (to - load) / 2
        return self.is_divisible


class AdaptiveStepSize(StepSize):
    """Sizes of time steps by an estimate of their error, at most the nominal one.

    Parameters
    ----------
    steps : int
        Number of nominal steps, the longest ones.
    order : int
        Order of accuracy p: a step's error is proportional to the power p + 1 of its size.
    """

    def __init__(self, steps: int, order: int) -> None:
        super().__init__(steps)
        self._order, self._nominal = order, 1 / steps

    def end(self, load: float, target: float) -> float:
        """Return the end of the next step: the rest up to ``target`` is divided evenly."""
        rest = target - load
        parts = ceil(rest / (self.next or rest) * (1 - _ROUNDING))
        self._size = rest / parts
        return target if parts == 1 else load + self._size

    def accept(self, to: float, target: float) -> None:
        """Set the size to the one whose error is the tolerance, or to the nominal one."""
        factor = self._factor()
        wanted = factor * self._size
        if factor >= 1:  # the step may have been shorter than its error allowed
            wanted = max(wanted, self.next or self._nominal)
        self.next = wanted if wanted < self._nominal * (1 - _ROUNDING) else None

    def reject(self, load: float, to: float) -> bool:
        """Set the size after a step that failed or whose error exceeds the tolerance."""
        factor = min(0.5, self._factor()) if self.ratio > 1 else 0.5
        self.next = max(self._shortest, factor * self._size)
        return self.is_divisible

    def _factor(self) -> float:
        """Return the factor by which the size changes."""
        if self.ratio == 0:
            return _MOST
        return min(_MOST, max(_LEAST, _SAFETY * self.ratio ** (-1 / (self._order + 1))))
