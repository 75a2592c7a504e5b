"""The stretch to 3.4 times the length: volumes of the materials of Smith et al. 2018."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row, split_list
from fem_snh.runs import run

#: Volume change [%] at nu = 0.49, stretch 3.4 (Smith et al. 2018, section 6). The proportions of
#: their cylinder are not published.
PAPER = {
    "stable_neo_hookean": 4.3,
    "fixed_corotational": 4.5,
    "filtered_neo_hookean": 4.9,
}
#: Materials that are expected to fail here, with the result of Smith et al. 2018 or the reason.
EXPECTED_FAILURES = {
    "corotational": "collapses: volume -83 % in Smith et al. 2018, section 6",
    "neo_hookean": "log J is undefined once an element is inverted",
}
#: Cells along the diameter.
CELLS = {"Q1": 12, "P1": 12, "Q2": 6, "P2": 6}


def rows(
    elements: str = "Q1,P2",
    materials: str = "",
    cells: int = 0,
    steps: int = 12,
    nu: float = 0.49,
    aspect: float = 1.0,
) -> Iterator[Row]:
    """Yield one row per element and material.

    Yields
    ------
    dict
        ``expected``: "converges", or why a failure is expected. ``ok``: it converged without a
        halved step, or its failure was expected.
    """
    for element in split_list(elements):
        for material in split_list(materials) or PAPER:
            result = run(
                "stretch",
                material=material,
                element=element,
                cells=cells or CELLS.get(element, 6),
                steps=steps,
                nu=nu,
                aspect=aspect,
                progress=False,
            )
            done = result.steps
            converged = result.converged and len(done) == steps
            failure = EXPECTED_FAILURES.get(material)
            yield {
                "element": element,
                "material": material,
                "cells": result.record["cells"],
                "dofs": result.record["dofs"],
                "ranks": result.record["ranks"],
                "steps": len(done),
                "newton": sum(step["newton"] for step in done),
                "linear": sum(step["linear"] for step in done),
                "volume_percent": round(100 * (done[-1]["volume_ratio"] - 1), 3),
                "paper_volume_percent": PAPER.get(material) if nu == 0.49 else None,
                "min_J": done[-1]["min_J"],
                "seconds": round(result.record["seconds"]["total"], 2),
                "converged": result.converged,
                "expected": f"may fail: {failure}" if failure else "converges",
                "ok": converged or failure is not None,
            }
