"""The family "aspect": sheets and struts up to 1 : 1000, and slivers of 0.1 degree.

*sheet*: a square, clamped at one edge, 1 to 1000 times as wide as thick; the opposite edge is
stretched by 20 % and moved out of the plane by a tenth of the width. *strut*: 1 to 1000 times as
long as wide; its end is moved to the side by a tenth of the length. *slivers*: a cube whose first
layer of tetrahedra is so thin that they have angles of 1 and 0.1 degrees. All in one step, each
with a tight solve as for stiff inclusions.
"""

from __future__ import annotations

from itertools import product
from math import radians, tan
from typing import Any

from benchmarks.extremes import bodies
from benchmarks.extremes.cases import Case, converged, scene_case

_ELEMENTS = ("Q1P0", "P2P0", "Q1", "P1", "Q2", "P2")
#: Sizes of a cell of a sheet's and of a cube's edge.
_CELLS = {"1": 8, "2": 4}
#: Cells along a strut's edge, and the largest angle of its bending, relative to its length.
_STRUT_CELLS, _BEND = 1, 0.1


#: Cases that may take minutes: 1000 cells of P2P0, nu = 0.499, as long as wide.
_SLOW = ("strut-1to1000",)


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases of every shape and element, each with a tight solve."""
    made: list[Case] = []
    aspects = (1000,) if quick else (1, 10, 100, 1000)
    elements = _ELEMENTS[: 1 if quick else None]
    for element, aspect in product(elements, aspects):
        cells = _CELLS[element[1]]
        shapes: dict[str, dict[str, Any]] = {
            "sheet": {"length": 1 / aspect, "cells": cells, "stretch": 0.2, "bend": 0.1},
            "strut": {"length": float(aspect), "cells": _STRUT_CELLS, "stretch": 0.0},
        }
        if aspect == 1:
            shapes = {"cube": {"length": 1.0, "cells": cells, "stretch": 0.2}}
        made += [_case(f"{name}-1to{aspect}", element, keys) for name, keys in shapes.items()]
    for element in ("P1", "P2P0") if not quick else ("P1",):
        cells = _CELLS[element[1]]
        for angle in (1.0, 0.1):
            # The first layer of cells is so thin that its tetrahedra have this angle.
            thin = {"length": 1.0, "cells": cells, "first": tan(radians(angle)) / cells}
            made.append(_case(f"slivers-{angle:g}deg", element, {**thin, "stretch": 0.2}))
    return made


def _case(name: str, element: str, keys: dict[str, Any]) -> Case:
    """Return a case with a tight solve."""
    nu = 0.499 if "P0" in element else 0.45
    return scene_case(
        bodies.reference(bodies.bar), f"aspect-{name}-{element}", "reaches its load in one step",
        converged, name not in _SLOW, tight=True, element=element, nu=nu, **keys,
    )  # fmt: skip
