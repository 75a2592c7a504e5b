"""An elastic ball pressed on a rigid plane: Hertz's contact, and code_aster's test SSNV104."""

from math import sqrt

from pydantic import PositiveFloat

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Obstacle, Scene

#: Radius [mm], Young's modulus [MPa] and Poisson's ratio of SSNV104.
RADIUS, MODULUS, RATIO = 50.0, 2e4, 0.3
#: The mesh is fine up to this multiple of Hertz's contact radius.
ZONE = 1.25
#: Radius of the half ball that stands for a half-space, in units of RADIUS. Its surface is fixed,
#: which raises the force by about contact radius / (FAR RADIUS): 0.2 % at depth 0.2.
FAR = 40.0
#: The solver's tolerance is relative to the force E V^(2/3) of a ball of RADIUS.
TOLERANCE = 1e-7


def hertz(cells: int = 6, depth: PositiveFloat = 0.2, half_space: bool = False) -> Scene:
    """An octant of a ball of radius 50 mm; a rigid plane moves into it by a depth.

    Hertz's theory takes the ball for a half-space. It has the force
    4/3 E/(1 - nu^2) sqrt(R) depth^(3/2), the contact radius sqrt(R depth), and the peak pressure
    2 E/(1 - nu^2) sqrt(depth/R)/pi (Johnson 1985, chapter 4), and so has a rigid ball of this
    radius that moves into an elastic half-space.

    Parameters
    ----------
    cells : int
        Cells along 1.25 contact radii from the pole.
    depth : float
        Displacement of the plane towards the centre, or of the rigid ball [mm].
    half_space : bool
        An elastic half-space under a rigid ball, instead of an elastic ball under a rigid plane.
    """
    zone = ZONE * sqrt(RADIUS * depth)
    parameters: dict[str, float] = {"radius": RADIUS, "zone": zone, "order": 2}
    petsc: dict[str, bool | int | float | str | None] = {}
    symmetric = [Hold(group=f"{axis} = 0", components=(axis,)) for axis in ("x", "y")]
    if half_space:
        parameters |= {"flat": 1, "radius": FAR * RADIUS}
        hold, touched = Hold(group="surface"), "z = 0"
        ball = {"sphere": {"center": [0, 0, RADIUS], "radius": RADIUS}}
        obstacle = Obstacle(name="ball", shape=ball, translate=(0, 0, -depth), group=touched)
        petsc = {"snes_scaled_tol": TOLERANCE / FAR**2}
    else:
        hold, touched = Hold(group="z = 0", components=("z",)), "surface"
        plane = {"plane": {"point": [0, 0, -RADIUS], "normal": [0, 0, 1]}}
        obstacle = Obstacle(name="plane", shape=plane, translate=(0, 0, depth), group=touched)
    return Scene(
        name="hertz",
        mesh=Geometry(source="indenter", parameters=parameters),
        cells=cells,
        element="P2",
        material=MaterialChoice(name="stable_neo_hookean", E=MODULUS, nu=RATIO),
        hold=[*symmetric, hold],
        obstacle=[obstacle],
        fields=["contact_pressure"],
        predictor="none",
        petsc=petsc,
        load_name="depth [mm]",
        load_range=(0.0, depth),
    )
