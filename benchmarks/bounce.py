"""The energy that a soft ball loses when it bounces, by time integrator and time step.

Limit: Newmark loses at most 1 % of the energy of the fall.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import Row, split_list
from fem_snh.choices import INTEGRATORS
from fem_snh.mesh.mesh import volume
from fem_snh.runs import run
from fem_snh.scenes.builtin.bounce import DENSITY, GRAVITY


def rows(
    integrators: str = ",".join(INTEGRATORS),
    steps: str = "200,400",
    cells: int = 6,
    height: float = 0.5,
) -> Iterator[Row]:
    """Let the ball of the scene ``bounce`` fall for 1 s, in which it bounces once.

    Parameters
    ----------
    integrators : str
        Time integrators.
    steps : str
        Time steps in 1 s.
    cells : int
        Cells along the diameter.
    height : float
        Height of the fall [m].
    """
    for integrator in split_list(integrators):
        for number in map(int, split_list(steps)):
            yield measure(integrator, number, cells, height)


def measure(integrator: str, steps: int, cells: int, height: float) -> Row:
    """Return the loss, relative to m g h, and what the bounce costs."""
    changes: dict[str, Any] = {"time.integrator": integrator, "time.steps": steps}
    result = run("bounce", cells=cells, height=height, progress=False, **changes)
    found = result.record["steps"]
    energies = [row["energy"] for row in found]
    fall = DENSITY * volume(result.problem.domain) * GRAVITY * height
    loss = (energies[0] - energies[-1]) / fall
    touching = [row for row in found if row["obstacles"]["ground"]["contacts"]]
    row: Row = {
        "integrator": integrator,
        "steps": steps,
        "dofs": result.problem.dofs,
        "converged": result.converged,
        "loss": float(f"{loss:.4g}"),
        "steps_in_contact": len(touching),
        "newton": sum(row["newton"] for row in found),
        "penetration": max(
            (r["obstacles"]["ground"]["penetration"] for r in touching), default=0.0
        ),
    }
    if integrator == "newmark":
        row["ok"] = bool(result.converged and loss <= 0.01)
    return row
