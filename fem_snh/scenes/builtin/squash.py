"""The squashed octopus of Smith et al. 2018, Figure 11."""

from pydantic import PositiveFloat

from fem_snh.scenes import (
    Amplitude,
    Damping,
    Geometry,
    Gravity,
    MaterialChoice,
    Obstacle,
    Scene,
    Time,
)
from fem_snh.tables.types import Count

#: Frames a second, and semi-implicit steps a frame as in Smith et al. 2018.
FRAME_RATE, SUBSTEPS = 24, 10
#: Times [s] at which the press begins to sink, is down, begins to rise and is up, and the end. The
#: octopus is at rest at the first and the last time, to 0.1 % of the arms' span at the worst node.
TIMES = (1.0, 1.25, 1.375, 1.625, 2.25)
FRAMES = round(TIMES[-1] * FRAME_RATE)
#: Radii of the three cylinders and of the press, distance of neighbouring axes [m].
RADIUS, PRESS_RADIUS, DISTANCE = 0.025, 0.12, 0.06
#: Height of the axes of the three cylinders [m]: the lowest point of the octopus is at -0.06 m.
HEIGHT = -0.11
#: Coulomb's coefficient of a wet body.
FRICTION = 0.05
#: How far the press sinks [m]: it starts above the octopus.
STROKE = 0.3


def squash(
    cells: int = 54,
    gap: PositiveFloat = 0.02,
    substeps: Count = SUBSTEPS,
    friction: PositiveFloat = FRICTION,
) -> Scene:
    """An octopus dropped on three cylinders, squashed by a fourth, and released.

    Parameters
    ----------
    cells : int
        Cells from the tip of an arm to the tip of the opposite arm: 54 give 20,000 tetrahedra, 157
        the 394,000 of Smith et al. 2018.
    gap : float
        Distance of the press from the middle cylinder when it is down [m].
    substeps : int
        Time steps a frame; there are 24 frames a second.
    friction : float
        Coulomb's coefficient. Friction can hold a body at rest in many shapes: the larger it is,
        the more may the octopus's shape after the release differ from its shape before.
    """
    axes = [(x, HEIGHT) for x in (-DISTANCE, 0.0, DISTANCE)]
    cylinders = [
        Obstacle(name=name, shape=_cylinder(x, z, RADIUS), friction=friction)
        for name, (x, z) in zip(("left", "middle", "right"), axes, strict=True)
    ]
    down = HEIGHT + RADIUS + gap + PRESS_RADIUS
    press = Obstacle(
        name="press",
        shape=_cylinder(0.0, down + STROKE, PRESS_RADIUS),
        translate=(0, 0, -STROKE),
        table="press",
        friction=friction,
    )
    heights = zip(TIMES, (0, 1, 1, 0, 0), strict=True)
    return Scene(
        name="squash",
        mesh=Geometry(source="octopus"),
        cells=cells,
        element="P1",
        # Without a line search a step follows a direction without stiffness until inertia stops it,
        # many cells away. `clamp` leaves inverted cells such directions.
        hessian="abs",
        material=MaterialChoice(name="stable_neo_hookean", E=3e5, nu=0.46, density=1000),
        gravity=Gravity(vector=(0, 0, -9.81)),
        obstacle=[*cylinders, press],
        table=[Amplitude(name="press", points=tuple(heights))],
        time=Time(
            duration=TIMES[-1],
            steps=FRAMES * substeps,
            integrator="semi_implicit",
            damping=Damping(mass=10.0),
            output_every=substeps,
        ),
        load_name="time [s]",
        load_range=(0, TIMES[-1]),
    )


def _cylinder(x: float, z: float, radius: float) -> dict[str, object]:
    """Return an infinite cylinder whose axis is parallel to y."""
    ends = {"from": (x, -1, z), "to": (x, 1, z)}
    return {"cylinder": ends | {"radius": radius, "infinite": True}}
