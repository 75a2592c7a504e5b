"""A soft ball that bounces on the ground."""

from pydantic import NonNegativeFloat, PositiveFloat

from fem_snh.choices import DEFAULT_INTEGRATOR
from fem_snh.scenes import Geometry, Gravity, MaterialChoice, Obstacle, Scene, Time

#: Radius [m], density [kg/m^3] and acceleration of gravity [m/s^2].
RADIUS, DENSITY, GRAVITY = 0.5, 1000.0, 9.81


def bounce(
    cells: int = 6,
    height: PositiveFloat = 0.5,
    integrator: str = DEFAULT_INTEGRATOR,
    friction: NonNegativeFloat = 0.0,
) -> Scene:
    """A ball of radius 0.5 m, E = 1e5 Pa, that falls on the ground, for 1 s.

    Parameters
    ----------
    cells : int
        Cells along the diameter.
    height : float
        Initial distance of the ball from the ground [m].
    integrator : str
        The time integrator.
    friction : float
        Coulomb's coefficient of the ground.
    """
    ground = {"plane": {"point": (0, 0, -RADIUS - height)}}
    return Scene(
        name="bounce",
        mesh=Geometry(source="ball", parameters={"radius": RADIUS}),
        cells=cells,
        element="P1",
        material=MaterialChoice(name="stable_neo_hookean", E=1e5, nu=0.4, density=DENSITY),
        time=Time(duration=1.0, steps=200, integrator=integrator),
        gravity=Gravity(vector=(0, 0, -GRAVITY)),
        obstacle=[Obstacle(name="ground", shape=ground, friction=friction)],
    )
