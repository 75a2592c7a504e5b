"""An O-ring pressed between two rigid plates, or in a groove."""

from math import pi
from typing import Annotated, Any

from pydantic import Field, NonNegativeFloat, PositiveFloat

from fem_snh.errors import bad_value
from fem_snh.scenes import Geometry, MaterialChoice, Obstacle, Reaction, Scene, Symmetry
from fem_snh.tables.validation import OneOf

#: Angle of the sector that is modelled in three dimensions [degrees].
SECTOR = 15
#: The width of the land on both sides of a groove [mm].
_LAND = 2.0

Kinematics = Annotated[str, OneOf(("axisymmetric", "plane_strain", "3D"))]


def seal(
    cells: int = 12,
    squeeze: Annotated[float, Field(gt=0, lt=1)] = 0.3,
    friction: NonNegativeFloat = 0.2,
    ring: Annotated[float, Field(gt=1)] = 5.0,
    groove: PositiveFloat | None = None,
    kinematics: Kinematics = "axisymmetric",
) -> Scene:
    """A rubber O-ring whose cord two frictional plates press by 30 % of its height.

    The cord has the radius 1 mm, E is in MPa. The plates move towards each other by the same
    distance. With a groove, the lower plate is at rest, and the upper plate reaches the groove's
    edge at load 1.

    Parameters
    ----------
    cells : int
        Cells along the cord's diameter.
    squeeze : float
        Approach of the plates at load 1, relative to the height of the cord at rest.
    friction : float
        Coulomb's coefficient.
    ring : float
        Radius of the centre line of the cord [mm], more than the radius of the cord.
    groove : float, optional
        Width of a rectangular groove in the lower plate, whose floor the cord is on [mm].
    kinematics : str
        "axisymmetric", "plane_strain" for half of a straight cord, or "3D" for a sector of 15
        degrees of the ring.
    """
    straight, solid = kinematics == "plane_strain", kinematics == "3D"
    center = 0.0 if straight else ring
    lower: dict[str, Any] = _plate(-1, squeeze)
    if groove is None:
        upper = _plate(1, squeeze)
    elif solid:
        raise bad_value("groove", groove, "no value with kinematics = '3D'")
    else:
        upper = _plate(1, 2 * squeeze)
        lower = {"shape": {"polygon": {"points": _groove(center, groove, squeeze, straight)}}}
    plates = {"lower": lower, "upper": upper}
    cut = ("start", "end") if solid else ("middle",) if straight else ()
    return Scene(
        name="seal",
        mesh=Geometry(source="cord", parameters={"center": center, "half": float(straight)}),
        cells=cells,
        element="P2P0",
        kinematics=None if solid else kinematics,
        steps=6,
        material=MaterialChoice(name="stable_neo_hookean", E=6.0, nu=0.499),
        symmetry=[Symmetry(group=group) for group in cut],
        reactions=[Reaction(group="middle")] if straight else [],
        obstacle=[
            Obstacle(name=name, group="surface", friction=friction, **plate)
            for name, plate in plates.items()
        ],
        fields=["contact_pressure"],
        load_name="squeeze",
        load_range=(0, squeeze),
    )


def _plate(side: int, way: float) -> dict[str, Any]:
    """Return the plate above (1) or below (-1), which moves by ``way`` [mm] towards the cord."""
    plane = {"point": [0, side, 0], "normal": [0, -side, 0]}
    return {"shape": {"plane": plane}, "translate": [0, -side * way, 0]}


def _groove(center: float, width: float, squeeze: float, straight: bool) -> list[list[float]]:
    """Return the corners of a plate with a groove, whose depth is the height of the cord at load 1.

    BadInput if the cord does not fit in.
    """
    depth = 2 * (1 - squeeze)
    if not width >= 2:
        raise bad_value("groove", width, "a number of at least 2, the diameter of the cord")
    if not width * depth > pi:
        most = 1 - pi / (2 * width)
        raise bad_value("squeeze", squeeze, f"below {most:.3f}, at which the cord fills its groove")
    low, high = center - width / 2, center + width / 2
    if not (straight or low > 0):
        raise bad_value("groove", width, f"a number below {2 * center:g}, twice the ring's radius")
    inner = low - _LAND if straight else max(low - _LAND, low / 2)
    top = depth - 1
    return [
        [inner, -1 - _LAND], [high + _LAND, -1 - _LAND], [high + _LAND, top], [high, top],
        [high, -1], [low, -1], [low, top], [inner, top],
    ]  # fmt: skip
