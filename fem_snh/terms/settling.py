"""Quantities that are constant during a solve and change after it: when they have settled.

Multipliers, lagged friction and pairs of surfaces that touch are such quantities. A step is solved
again until their changes are below the terms' tolerances; `MAX_SOLVES` solves without that make it
fail.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, isnan
from typing import NamedTuple

#: Solves of a step after which lagged quantities that still change make it fail. Lagged friction
#: converges linearly, by factors of 2 to 10 a solve, and augmentations leave E/(k h) of the gap;
#: what has not settled then alternates, or cannot: nodes that are constrained cannot follow.
MAX_SOLVES = 51

#: Solves of a step after which it fails, if none of them has reduced the largest change below what
#: it had been before: pairs of an unstable state alternate. In the tests of contact and friction
#: quantities that settle have at most two such solves in turn.
MAX_STALLED = 10


def relative(change: float, size: float, tolerance: float) -> float:
    """Return ``change / (tolerance size)``: 0 without a change, infinity without a size."""
    if change == 0:
        return 0.0
    return float(change / (tolerance * size)) if size > 0 else inf


class LaggedChange(NamedTuple):
    """The change of a term's lagged quantities after a solve.

    Attributes
    ----------
    ratio : float
        The change over its tolerance: above 1 the step is solved again.
    what : str
        What changes, for the reason of a failure.
    slid_off : bool
        Whether points that touched are beside the edge of the other surface now.
    """

    ratio: float = 0.0
    what: str = ""
    slid_off: bool = False

    @property
    def settled(self) -> bool:
        """Whether the change is below its tolerance; NaN is not."""
        return self.ratio <= 1


def largest_change(changes: Iterable[LaggedChange]) -> LaggedChange:
    """Return the largest of some changes, or NaN if one is; without any, no change."""
    return max(changes, key=lambda change: (isnan(change.ratio), change), default=LaggedChange())
