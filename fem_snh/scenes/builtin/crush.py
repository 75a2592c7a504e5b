"""A cube that is released from a collapsed or an inverted state."""

from __future__ import annotations

from typing import Annotated

from pydantic import NonNegativeFloat, NonNegativeInt

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Scene, Start
from fem_snh.tables.validation import OneOf

#: Stretches in x, y and z of the initial state.
STRETCHES: dict[str, tuple[float, float, float]] = {
    "plane": (1, 1, 0),
    "line": (1, 0, 0),
    "point": (0, 0, 0),
    "inverted": (-1, -1, -1),
}


def crush(
    cells: int = 2,
    to: Annotated[str, OneOf(STRETCHES)] = "plane",
    noise: NonNegativeFloat = 0.0,
    seed: NonNegativeInt = 0,
) -> Scene:
    """A unit cube released from a plane, a line, a point or an inverted state.

    One corner is fixed, a second one stays on the x axis and a third one in the plane z = 0. These
    conditions remove the rigid motions and cause no stress, so the initial deformation gradient is
    the same everywhere. The body may return to rest rotated by half a turn about an axis.

    Parameters
    ----------
    cells : int
        Hexahedra along an edge; tetrahedra divide each of them into several.
    to : {"plane", "line", "point", "inverted"}
        The initial state.
    noise : float
        Largest random displacement added to each component [length].
    seed : int
        Seed of the random numbers.
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
