"""The family "contrast": a stiff inclusion in a soft cube, from 1 to 1e8.

A unit cube with a sphere or a bar inside, 1 to 1e8 times as stiff as the rest. A face is moved by
(0.3, 0.2, 0) in one step, which turns the inclusion. nu is 0.499 with the elements that do not
lock, 0.45 with the others.

Each case has a tight solve beside it (`-tight`): from the state of the case, with sparse factors
and a tolerance of 1e-9. Displacements, reactions and energy may differ by 1 %; the column
*difference* has the largest relative difference.
"""

from __future__ import annotations

from itertools import product

from benchmarks.extremes import bodies
from benchmarks.extremes.cases import Case, converged, scene_case

_ELEMENTS = ("Q1", "P1", "Q1P0", "P2P0", "Q2", "P2", "P2P1", "Q2Q1")
#: Elements that do not lock; they have nu = 0.499, the others 0.45.
_LOCKING_FREE = ("Q1P0", "P2P0", "P2P1", "Q2Q1")
#: Elements that find unstable equilibria, which a tight solve leaves: it may differ.
_UNSTABLE = ("P2P0",)
#: Elements with every contrast; the others have some.
_EVERY_CONTRAST = ("Q1", "P2P0")
#: Cells along an edge by the degree of the displacement.
_CELLS = {"1": 8, "2": 4}


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases of every shape, contrast and element, each with a tight solve."""
    made: list[Case] = []
    for element, shape, exponent in product(
        _ELEMENTS[: 1 if quick else None], ("sphere", "bar"), (0, 2, 4, 6, 8)
    ):
        if exponent in (2, 6) and (quick or element not in _EVERY_CONTRAST):
            continue
        made.append(
            scene_case(
                bodies.reference(bodies.inclusion),
                f"contrast-{shape}-1e{exponent}-{element}",
                "reaches its load in one step", converged,
                element not in _UNSTABLE,
                tight=True, shape=shape, contrast=10.0**exponent, element=element,
                nu=0.499 if element in _LOCKING_FREE else 0.45,
                cells=_CELLS[element[1]] // (2 if quick else 1),
            )
        )  # fmt: skip
    return made
