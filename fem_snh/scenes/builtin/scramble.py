"""The scrambled cube of the paper's Figure 3."""

from __future__ import annotations

from pydantic import NonNegativeInt, PositiveFloat

from fem_snh.scenes.schema import Geometry, Hold, MaterialChoice, Scene, Start

#: No plane through them, so no mirror image of the cube and no turned one fits.
CORNERS = ("000", "110", "101", "011")


def scramble(cells: int = 10, seed: NonNegativeInt = 0, scatter: PositiveFloat = 2.0) -> Scene:
    """A unit cube whose vertices begin anywhere in a cube of twice its volume, and go home.

    Four corners are pinned, every other one of the eight; the paper does not say which.

    Args:
        cells: hexahedra along an edge (tetrahedra: each cut into several).
        seed: of the random numbers.
        scatter: the volume in which the vertices begin.
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
        # At rest to 1e-6 of the side: a residual of 1e-7 alone leaves up to 1e-5 in soft modes.
        petsc={"snes_scaled_tol": 1e-9, "snes_max_it": 1000},
        load_name="release",
    )
