"""The family "aspect": sheets and struts up to 1 : 1000, and slivers of 0.1 degree."""

from __future__ import annotations

from itertools import product
from math import radians, tan
from typing import Any

from fem_snh.studies.extremes import bodies
from fem_snh.studies.extremes.cases import Case, converged, scene_case
from fem_snh.studies.extremes.tight import with_tight

LABEL, BY = "aspect-(.*)-", ()
_ELEMENTS = ("Q1P0", "P2P0", "Q1", "P1", "Q2", "P2")
#: Sizes of a cell of a sheet's and of a cube's edge.
_CELLS = {"1": 8, "2": 4}
#: Cells along a strut's edge, and the largest angle of its bending, relative to its length.
_STRUT_CELLS, _BEND = 1, 0.1


#: Cases that may take minutes: 1000 cells of P2P0, nu = 0.499, as long as wide.
_SLOW = ("strut-1to1000",)


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
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
        made += [
            each
            for name, keys in shapes.items()
            for each in _case(f"{name}-1to{aspect}", element, keys, material)
        ]
    for element in ("P1", "P2P0") if not quick else ("P1",):
        cells = _CELLS[element[1]]
        for angle in (1.0, 0.1):
            # The first layer of cells is so thin that its tetrahedra have this angle.
            thin = {"length": 1.0, "cells": cells, "first": tan(radians(angle)) / cells}
            made += _case(f"slivers-{angle:g}deg", element, {**thin, "stretch": 0.2}, material)
    return made


def _case(name: str, element: str, keys: dict[str, Any], material: str) -> list[Case]:
    """Return a case and its tight solve."""
    nu = 0.499 if "P0" in element else 0.45
    case = scene_case(
        bodies.reference(bodies.bar), f"aspect-{name}-{element}", "reaches its load in one step",
        converged, material, name not in _SLOW, element=element, nu=nu, **keys,
    )  # fmt: skip
    return with_tight(case)
