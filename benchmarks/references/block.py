"""The nearly incompressible block under partial pressure."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row
from benchmarks.references.compare import compare, solve
from fem_snh.fem.elements import ELEMENTS
from fem_snh.linalg.direct_solver import DIRECT_SOLVER

SOURCE = "Schröder et al. 2021, table 3.{}"
#: Table 3.3 by the cells along an edge: displacement element and mean dilatation.
Q1 = {4: 7.78, 8: 13.17, 16: 17.54}
Q1P0 = {4: 19.87, 8: 20.02, 16: 20.01}
#: Table 3.4: order 1 on 4 x 4 x 4 cells, the same element and mesh as table 3.3's 7.78.
Q1_AGAIN = 7.656
#: What all of table 3.3's locking-free elements agree on: 19.98 to 20.01 on 32 x 32 x 32 cells.
CONVERGED = 20.00
#: The cells that take elements of order 2 there.
ORDER_2 = {"P2P0": 6, "Q2": 6, "P2P1": 6, "Q2Q1": 6}


def block(finest: int = 16) -> Iterator[Row]:
    """The middle of the top sinks by 20 mm: our Q1 and Q1P0 beside theirs, then the others."""
    cases = [("Q1", 4, Q1_AGAIN, SOURCE.format(4), 0.01)]
    # Between themselves the two tables' Q1 differ by 1.6 %.
    cases += [("Q1", cells, value, SOURCE.format(3), 2.0) for cells, value in Q1.items()]
    cases += [("Q1P0", cells, value, SOURCE.format(3), 0.5) for cells, value in Q1P0.items()]
    cases += [(e, cells, CONVERGED, SOURCE.format(3), 1.0) for e, cells in ORDER_2.items()]
    for element, cells, published, source, limit in cases:
        if cells <= finest:
            mixed = ELEMENTS[element].volume == "pressure"
            _, step = solve(
                "block", element=element, cells=cells, petsc=DIRECT_SOLVER if mixed else {}
            )
            ours = step and -float(step["probes"]["middle"][2])
            what = f"-u_z (0, 0, 50) [mm], {element}, {cells} x {cells} x {cells}"
            yield compare(what, source, published, ours, limit)
