"""A cube pressed flat, or worse, and let go."""

from __future__ import annotations

from typing import Literal

from pydantic import NonNegativeFloat, NonNegativeInt

from fem_snh.scenes.schema import Geometry, Hold, MaterialChoice, Scene, Start

#: What stays of each direction.
STRETCHES: dict[str, tuple[float, float, float]] = {
    "plane": (1, 1, 0),
    "line": (1, 0, 0),
    "point": (0, 0, 0),
    "inverted": (-1, -1, -1),
}


def crush(
    cells: int = 2,
    to: Literal["plane", "line", "point", "inverted"] = "plane",
    noise: NonNegativeFloat = 0.0,
    seed: NonNegativeInt = 0,
) -> Scene:
    """A unit cube, every element of it pressed to a plane, a line or a point, or turned inside out.

    A corner stays, the next one on the x axis, the next in the plane z = 0: what the body needs to
    be somewhere, and nothing that a crushed one must resist. So the deformation gradient is the
    same everywhere, and no support holds it. The body may come back turned by half about an axis.

    Args:
        cells: hexahedra along an edge (tetrahedra: each cut into several).
        to: "plane", "line", "point" or "inverted".
        noise: by how much every node is moved from there at random [length].
        seed: of the random numbers.
    """
    x, y, z = STRETCHES[to]
    return Scene(
        name="crush",
        mesh=Geometry(source="cube"),
        cells=cells,
        element="Q1",
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.49),
        hold=[
            Hold(group="corner_000"),
            Hold(group="corner_100", components=("y", "z")),
            Hold(group="corner_010", components=("z",)),
        ],
        start=Start(
            map=((x, 0, 0), (0, y, 0), (0, 0, z)), through=(0, 0, 0), noise=noise, seed=seed
        ),
        predictor="none",
        petsc={"snes_scaled_tol": 1e-9, "snes_max_it": 1000},
        load_name="release",
    )
