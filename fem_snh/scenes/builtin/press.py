"""A cube that a plane presses flat."""

from pydantic import NonNegativeFloat, PositiveFloat

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Obstacle, Scene


def press(cells: int = 4, to: PositiveFloat = 0.5, friction: NonNegativeFloat = 0.0) -> Scene:
    """A cube of side 1 m, E = 1e5 Pa, pressed by a plane to a part of its height.

    Its bottom is fixed to the ground.

    Parameters
    ----------
    cells : int
        Cells along the edge.
    to : float
        Height of the plane at load 1, relative to the height of the cube.
    friction : float
        Coulomb's coefficient.
    """
    plate = {"plane": {"point": (0, 0, 1), "normal": (0, 0, -1)}}
    return Scene(
        name="press",
        mesh=Geometry(source="cube"),
        cells=cells,
        element="Q1",
        steps=4,
        material=MaterialChoice(name="stable_neo_hookean", E=1e5, nu=0.45, density=1000),
        hold=[Hold(group="bottom")],
        obstacle=[
            Obstacle(name="plate", shape=plate, translate=(0, 0, to - 1), friction=friction),
            Obstacle(name="ground", shape={"plane": {}}, friction=friction),
        ],
        load_name="height",
        load_range=(1.0, to),
    )
