"""The nearly incompressible block under partial pressure."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row
from benchmarks.references.compare import compare, solve
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.linalg.direct_solver import DIRECT_SOLVER

SOURCE = "Schröder et al. 2021, table 3.{}"
#: Table 3.3, by the cells along an edge: displacement element and mean dilatation.
Q1 = {4: 7.78, 8: 13.17, 16: 17.54}
Q1P0 = {4: 19.87, 8: 20.02, 16: 20.01}
#: Table 3.4: order 1 on 4 x 4 x 4 cells, the element and mesh of the 7.78 in table 3.3.
Q1_TABLE_4 = 7.656
#: The locking-free elements of table 3.3 give 19.98 to 20.01 on 32 x 32 x 32 cells.
CONVERGED = 20.00
#: Cells along an edge for elements of degree 2.
ORDER_2 = {"P2P0": 6, "Q2": 6, "P2P1": 6, "Q2Q1": 6}


def block(finest: int = 16) -> Iterator[Row]:
    """Yield the displacement of the middle of the top: Q1 and Q1P0, then the other elements."""
    cases = [("Q1", 4, Q1_TABLE_4, SOURCE.format(4), 0.01)]
    # The values of Q1 in the two tables differ by 1.6 %.
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
