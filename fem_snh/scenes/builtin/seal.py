"""An O-ring pressed between two rigid plates."""

from pydantic import NonNegativeFloat, PositiveFloat

from fem_snh.contact.obstacle import Obstacle
from fem_snh.errors import bad_value
from fem_snh.scenes.schema import Geometry, MaterialChoice, Reaction, Scene
from fem_snh.terms.symmetry import Symmetry


def seal(
    cells: int = 12,
    squeeze: PositiveFloat = 0.3,
    friction: NonNegativeFloat = 0.2,
    ring: PositiveFloat = 5.0,
    kinematics: str = "axisymmetric",
) -> Scene:
    """A rubber O-ring whose cord two frictional plates press by 30 % of its height.

    The cord has the radius 1 mm, E is in MPa. The plates move towards each other by the same
    distance.

    Parameters
    ----------
    cells : int
        Cells along the cord's diameter.
    squeeze : float
        Approach of the plates at load 1, in the height of the cord at rest.
    friction : float
        Coulomb's coefficient.
    ring : float
        Radius of the circle of the cord's centres [mm].
    kinematics : str
        "axisymmetric", or "plane_strain" for half of a straight cord.
    """
    accepted = ("axisymmetric", "plane_strain")
    if kinematics not in accepted:
        raise bad_value("kinematics", kinematics, f"one of {', '.join(accepted)}")
    if not squeeze < 1:
        raise bad_value("squeeze", squeeze, "a number below 1")
    if not ring > 1:
        raise bad_value("ring", ring, "a number above 1, the radius of the cord")
    straight = kinematics == "plane_strain"
    cord = {"half": 1.0} if straight else {"center": ring}
    plates = [
        {
            "name": name,
            "shape": {"plane": {"point": [0, side, 0], "normal": [0, -side, 0]}},
            "translate": [0, -side * squeeze, 0],
            "friction": friction,
        }
        for name, side in (("lower", -1), ("upper", 1))
    ]
    return Scene(
        name="seal",
        mesh=Geometry(source="cord", parameters=cord),
        cells=cells,
        element="P2P1",
        kinematics=kinematics,
        steps=6,
        material=MaterialChoice(name="stable_neo_hookean", E=6.0, nu=0.499),
        symmetry=[Symmetry(group="middle")] if straight else [],
        reactions=[Reaction(group="middle")] if straight else [],
        obstacle=[Obstacle.model_validate({**plate, "group": "surface"}) for plate in plates],
        fields=["contact_pressure"],
        load_name="squeeze",
        load_range=(0, squeeze),
    )
