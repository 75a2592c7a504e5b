"""A plate that falls on another one, both eight times as wide as thick: contact of thin bodies.

The lower plate is fixed at two ends, and the groups in contact are the whole surfaces. Limits: no
step is halved; no point is deeper than a tenth of the upper plate's thickness, and that plate stays
above the lower one; the energy does not grow by more than 1 % of the largest kinetic one. They are
for all but an augmented Lagrangian with `generalized_alpha`, and with `newmark`, whose steps may be
halved: a contact without any compliance is an impact that no time step resolves, and these
integrators keep what it excites.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks import Row, split_list
from fem_snh.choices import CONTACT_METHODS, INTEGRATORS
from fem_snh.problem.problem import Problem
from fem_snh.runs import run
from fem_snh.scenes import Contact, Geometry, Gravity, Hold, MaterialChoice, Scene, Time

#: Width over thickness of both plates; width and place of the upper one, gap between them [m].
ASPECT, WIDTH, SHIFT, GAP = 8, 0.6, 0.17, 0.01
#: Limits: penetration in the upper plate's thickness; distance of the plates' middles in that of
#: plates that touch; growth of the energy in the largest kinetic one.
DEEPEST, CLOSEST, GROWTH = 0.1, 0.8, 0.01

#: Integrators that keep the energy of high frequencies, at least the most of it.
KEEPING = ("newmark", "generalized_alpha")


def plates(element: str, integrator: str, method: str, cells: int = 4, steps: int = 50) -> Scene:
    """Return two plates of rubber, the upper one 1 cm above the lower one, for 0.25 s."""
    sizes = {"height": 1 / ASPECT, "upper_height": WIDTH / ASPECT, "layers": 1}
    place = {"gap": GAP, "upper_width": WIDTH, "shift": SHIFT}
    return Scene(
        name="plates",
        mesh=Geometry(source="two_blocks", parameters={**sizes, **place}),
        cells=cells,
        element=element,
        material=MaterialChoice(name="stable_neo_hookean", E=2e5, nu=0.4, density=1000.0),
        hold=[Hold(group="lower_ends")],
        gravity=Gravity(vector=(0, 0, -9.81)),
        contact=[Contact(groups=("lower_surface", "upper_surface"), method=method)],
        time=Time(duration=0.25, steps=steps, integrator=integrator),
    )


def rows(
    elements: str = "Q1,P1,P2",
    integrators: str = ",".join(INTEGRATORS),
    methods: str = ",".join(CONTACT_METHODS),
    cells: int = 4,
    steps: int = 50,
) -> Iterator[Row]:
    """Let the upper plate fall: one row per element, integrator and method.

    Parameters
    ----------
    elements, integrators, methods : str
        Names. The linearised steps of semi_implicit update multipliers once a step.
    cells : int
        Cells along a width; one across the thickness.
    steps : int
        Time steps in 0.25 s.
    """
    for element in split_list(elements):
        for integrator in split_list(integrators):
            for method in split_list(methods):
                yield measure(plates(element, integrator, method, cells, steps))


def measure(scene: Scene) -> Row:
    """Return what the impact costs, how deep the plates are in each other, and the energy."""
    assert scene.time
    result = run(scene, progress=False)
    steps = [step for step in result.steps if step["converged"]]
    contacts = [next(iter(step["contacts"].values())) for step in steps]
    kinetic = max(step["kinetic"] for step in steps)
    start = result.record["time"]["start"]["energy"]
    growth = (max(step["energy"] for step in steps) - start) / kinetic
    penetration = max(row["penetration"] for row in contacts) * ASPECT / WIDTH
    row: Row = {
        "element": scene.element,
        "integrator": scene.time.integrator,
        "method": scene.contact[0].method,
        "dofs": result.problem.dofs,
        "converged": result.converged,
        "halved": len(result.steps) - len(steps),
        "steps_in_contact": sum(row["contacts"] > 0 for row in contacts),
        "newton_a_step": round(sum(step["newton"] for step in result.steps) / len(steps), 1),
        "most_solves": max(step["solves"] for step in steps),
        "penetration": float(f"{penetration:.3g}"),
        "distance": float(f"{distance(result.problem):.3g}"),
        "min_J": float(f"{min(step['min_J'] for step in steps):.3g}"),
        "energy_growth": float(f"{growth:.3g}"),
    }
    if row["method"] == "penalty" or row["integrator"] not in KEEPING:
        row["ok"] = bool(
            row["converged"]
            and row["halved"] == 0
            and penetration < DEEPEST
            and row["distance"] > CLOSEST
            and growth < GROWTH
        )
    return row


def distance(problem: Problem) -> float:
    """Return the distance of the plates' middles over that of plates that just touch. Collective.

    The middles are means over the nodes, of the lower plate those below the upper one.
    """
    n = len(problem.coordinates)
    X, z = problem.coordinates, problem.x.array_r[2 : 3 * n : 3]
    upper = X[:, 2] > 1 / ASPECT + GAP / 2
    below = ~upper & (np.abs(X[:, :2] - SHIFT - WIDTH / 2) <= WIDTH / 2).all(axis=1)
    means = []
    for which in (upper, below):
        local = np.array([(X[which, 2] + z[which]).sum(), which.sum()])
        total, count = problem.comm.allreduce(local)
        means.append(total / count)
    return float((means[0] - means[1]) / ((1 + WIDTH) / (2 * ASPECT)))
