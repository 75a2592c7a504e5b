"""Scenes of the extremes: bodies of extreme contrast, shape, support and load.

Each is run by ``fem-snh run benchmarks/extremes/bodies.py:NAME``, as `reference` returns it.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any

from fem_snh.contact.contact_tables import Contact
from fem_snh.contact.obstacle import Obstacle
from fem_snh.scenes import (
    Geometry,
    Hold,
    MaterialChoice,
    Move,
    Reaction,
    Rigid,
    Rotate,
    Scene,
    Time,
    Traction,
)

#: Motion of the end of the cubes of `inclusion`: stretched and sheared.
_END = (0.3, 0.2, 0.0)
_MATERIAL = "stable_neo_hookean"


def reference(scene: Callable[..., Scene]) -> str:
    """Return the reference of a scene of this module, as ``fem-snh run`` accepts it."""
    return f"{__file__}:{scene.__name__}"


def inclusion(
    shape: str = "sphere", contrast: float = 1e4, cells: int = 8, rigid: float | None = None
) -> Scene:
    """A unit cube with a stiff sphere or bar inside, whose end is moved.

    Parameters
    ----------
    shape : str
        "sphere" or "bar".
    contrast : float
        Young's modulus of the inclusion over that of the rest.
    cells : int
        Cells along an edge, about.
    rigid : float, optional
        The inclusion is rigid, and turns by this angle about y in place of the end's motion.
    """
    materials = [
        MaterialChoice(name=_MATERIAL, E=1.0, nu=0.49, density=1.0),
        MaterialChoice(group="inclusion", name=_MATERIAL, E=contrast, nu=0.49, density=1.0),
    ]
    ends: dict[str, Any] = {
        "hold": [Hold(group="left")],
        "move": [Move(group="right", translate=_END)],
    }
    if rigid is not None:
        turn = Rotate(axis=(0, 1, 0), through=(0.5, 0.5, 0.5), angle=rigid)
        ends = {
            "hold": [Hold(group="left"), Hold(group="right")],
            "rigid": [Rigid(group="inclusion", rotate=turn)],
        }
    return Scene(
        name="inclusion",
        mesh=Geometry(source="inclusion", parameters={"bar": float(shape == "bar")}),
        cells=cells,
        element="Q1",
        material=materials,
        reactions=[Reaction(group="right")],
        **ends,
    )


def bar(
    length: float = 1.0, cells: int = 2, stretch: float = 0.1, bend: float = 0.1, first: float = 0.0
) -> Scene:
    """A bar [0, length] x [0, 1]^2 whose end is stretched and bent.

    Below a length of 1 it is a sheet, from one edge to the other, otherwise a strut.

    Parameters
    ----------
    length : float
        Length over width.
    cells : int
        Cells along an edge of length 1.
    stretch, bend : float
        Displacement of the end along and across the bar, relative to the longer edge.
    first : float
        Length of the first layer of cells; 0: half of the bar.
    """
    ends, unit = ("left", "right"), max(length, 1.0)
    along, across = (stretch * unit, 0.0, 0.0), (0.0, bend * unit, 0.0)
    if length < 1:
        ends = ("bottom", "top")
        along, across = (0.0, 0.0, stretch), (bend, 0.0, 0.0)
    end = (along[0] + across[0], along[1] + across[1], along[2] + across[2])
    return Scene(
        name="bar",
        mesh=Geometry(
            source="bar", parameters={"length": length, "interface": first or length / 2}
        ),
        cells=cells,
        element="Q1",
        material=MaterialChoice(name=_MATERIAL, E=1.0, nu=0.49),
        hold=[Hold(group=ends[0])],
        move=[Move(group=ends[1], translate=end)],
        reactions=[Reaction(group=ends[1])],
    )


def rollers(
    planes: str = "xy",
    load: float = 0.0,
    bodies: int = 1,
    touch: bool = False,
    moving: bool = False,
    kinematics: str | None = None,
    cells: int = 2,
) -> Scene:
    """A block on rollers, with a load on its end: held, or with too few supports.

    Parameters
    ----------
    planes : str
        Axes in whose direction a side is held, such as "xy"; empty: none.
    load : float
        Dead load on the last axis' far side, over E.
    bodies : int
        2: a second block above the first, without a support.
    touch : bool
        Whether contact may hold the blocks: an obstacle above.
    moving : bool
        In time.
    kinematics : str, optional
        Of a square in two dimensions.
    cells : int
        Cells along an edge.
    """
    sides = {"x": "left", "y": "bottom"} if kinematics else dict(zip("xyz", _SIDES, strict=True))
    top = "right" if kinematics and kinematics != "plane_strain" else "top"
    vector = (0.0, load, 0.0) if kinematics else (0.0, 0.0, load)
    source = "two_blocks" if bodies == 2 else "cook" if kinematics else "cube"
    parameters = {"gap": 0.5} if bodies == 2 else {}
    lid = {"plane": {"point": [0, 0, 3], "normal": [0, 0, -1]}}
    return Scene(
        name="rollers",
        mesh=Geometry(source=source, parameters=parameters),
        cells=cells,
        element="Q1",
        kinematics=kinematics,
        material=MaterialChoice(name=_MATERIAL, E=1.0, nu=0.3, density=1.0),
        hold=[Hold.model_validate({"group": sides[a], "components": [a]}) for a in planes],
        traction=[Traction(group=top, vector=vector)] if load else [],
        obstacle=[Obstacle.model_validate({"shape": lid})] if touch else [],
        time=Time(duration=1.0, steps=4) if moving else None,
    )


#: The sides of the cube that are held along x, y and z.
_SIDES = ("left", "front", "bottom")


def touched(
    force: float = 1e-6, by: str = "plate", cells: int = 4, friction: float = 0.0, nu: float = 0.45
) -> Scene:
    """A cube or two that a small force deforms: of a contact, a traction or a pressure.

    Parameters
    ----------
    force : float
        The force, about, over E V^(2/3).
    by : str
        "plate", "ball": an obstacle; "block": another cube; "traction": none.
    cells : int
        Cells along an edge.
    friction : float
        Coulomb's coefficient.
    nu : float
        Poisson's ratio.
    """
    parts: dict[str, Any] = {}
    source, parameters = "cube", {}
    if by == "plate":
        plate = {"plane": {"point": [0, 0, 1], "normal": [0, 0, -1]}}
        parts["obstacle"] = [_moving(plate, force, friction)]
    elif by == "ball":
        # Hertz: F = 4/3 E / (1 - nu^2) a^3 / R, and the depth a^2 / R, with a = 0.2
        radius = 4 / 3 / (1 - nu**2) * 0.2**3 / force
        depth = 0.2**2 / radius
        ball = {"sphere": {"center": [0.5, 0.5, 1 + radius], "radius": radius}}
        parts["obstacle"] = [_moving(ball, depth, friction)]
    elif by == "block":
        source, parameters = "two_blocks", {"gap": 0.0}
        surfaces = ("lower_top", "upper_bottom")
        parts["contact"] = [Contact(groups=surfaces)]
        parts["move"] = [Move(group="top", translate=(0, 0, -2 * force))]
    else:
        parts["traction"] = [Traction(group="top", vector=(0, 0, -force))]
    return Scene(
        name="touched",
        mesh=Geometry(source=source, parameters=parameters),
        cells=cells,
        element="Q1",
        material=MaterialChoice(name=_MATERIAL, E=1.0, nu=nu),
        hold=[Hold(group="bottom")],
        reactions=[Reaction(group="bottom")],
        **parts,
    )


def _moving(shape: dict[str, Any], depth: float, friction: float) -> Obstacle:
    """Return an obstacle that sinks."""
    return Obstacle.model_validate(
        {"name": "plate", "shape": shape, "translate": [0, 0, -depth], "friction": friction}
    )


def turned(
    angle: float = 2 * pi, length: float = 2.0, cells: int = 3, torque: float | None = None
) -> Scene:
    """A soft bar whose end is a rigid part that turns, or to which a torque is applied.

    Parameters
    ----------
    angle : float
        Rotation of the end about the bar's axis at load 1 [rad].
    length : float
        Length of the bar over its width, with the rigid half.
    cells : int
        Cells along an edge of length 1.
    torque : float, optional
        The part is free, and has this torque over E in place of the rotation.
    """
    centre = (length, 0.5, 0.5)
    turn = Rotate(axis=(1, 0, 0), through=centre, angle=angle)
    part = Rigid(group="second", rotate=turn)
    if torque is not None:
        part = Rigid(group="second", about=centre, torque=(torque, 0, 0))
    return Scene(
        name="turned",
        mesh=Geometry(source="bar", parameters={"length": length, "interface": length / 2}),
        cells=cells,
        element="Q1",
        material=MaterialChoice(name=_MATERIAL, E=1.0, nu=0.45),
        hold=[Hold(group="left")],
        rigid=[part],
        reactions=[Reaction(group="left", about=(0, 0.5, 0.5))],
    )
