"""An elastic ball pressed on a rigid plane: Hertz's contact, and code_aster's test SSNV104."""

from math import sqrt

from pydantic import PositiveFloat

from fem_snh.scenes._obstacles import ObstacleChoice
from fem_snh.scenes.schema import Geometry, Hold, MaterialChoice, Scene

#: Radius [mm], Young's modulus [MPa] and Poisson's ratio of SSNV104.
RADIUS, MODULUS, RATIO = 50.0, 2e4, 0.3
#: The mesh is fine up to this multiple of Hertz's contact radius.
ZONE = 1.25


def hertz(cells: int = 6, depth: PositiveFloat = 0.2) -> Scene:
    """An octant of a ball of radius 50 mm; a rigid plane moves into it by a depth.

    Hertz's theory of a half-space has the force 4/3 E/(1 - nu^2) sqrt(R) depth^(3/2) on the ball,
    the contact radius sqrt(R depth), and the peak pressure 2 E/(1 - nu^2) sqrt(depth/R)/pi
    (Johnson 1985, chapter 4).

    Parameters
    ----------
    cells : int
        Cells along 1.25 contact radii from the pole.
    depth : float
        Displacement of the plane towards the centre [mm].
    """
    zone = ZONE * sqrt(RADIUS * depth)
    plane = {"plane": {"point": [0, 0, -RADIUS], "normal": [0, 0, 1]}}
    return Scene(
        name="hertz",
        mesh=Geometry(source="indenter", parameters={"radius": RADIUS, "zone": zone, "order": 2}),
        cells=cells,
        element="P2",
        material=MaterialChoice(name="stable_neo_hookean", E=MODULUS, nu=RATIO),
        hold=[Hold(group=f"{axis} = 0", components=(axis,)) for axis in ("x", "y", "z")],
        obstacle=[
            ObstacleChoice.model_validate(
                {"name": "plane", "shape": plane, "translate": [0, 0, depth], "group": "surface"}
            )
        ],
        fields=["contact_pressure"],
        predictor="none",
        load_name="depth [mm]",
        load_range=(0.0, depth),
    )
