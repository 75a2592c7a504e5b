"""The scrambled cube of Smith et al. 2018, Figure 3."""

from __future__ import annotations

from pydantic import NonNegativeInt, PositiveFloat

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Scene, Start

#: Four corners that are not in one plane: they exclude a rotated or mirrored cube as a solution.
CORNERS = ("000", "110", "101", "011")


def scramble(cells: int = 10, seed: NonNegativeInt = 0, scatter: PositiveFloat = 2.0) -> Scene:
    """A unit cube that is released with its vertices at random in a cube of twice its volume.

    Four of the eight corners are fixed, no two of them on an edge; Smith et al. 2018 do not state
    which.

    Parameters
    ----------
    cells : int
        Hexahedra along an edge; tetrahedra divide each of them into several.
    seed : int
        Seed of the random numbers.
    scatter : float
        Volume in which the vertices are placed, relative to the volume of the body.
    """
    return Scene(
        name="scramble",
        mesh=Geometry(source="cube"),
        cells=cells,
        element="Q1",
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.49),
        hold=[Hold(group=f"corner_{corner}") for corner in CORNERS],
        start=Start(scatter=scatter, seed=seed),
        predictor="none",
        # Displacements below 1e-6 of the side: a residual of 1e-7 leaves up to 1e-5 in soft modes.
        petsc={"snes_scaled_tol": 1e-9, "snes_max_it": 1000},
        load_name="release",
    )
