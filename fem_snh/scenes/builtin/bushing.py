"""A bushing: rubber bonded between two rigid cylindrical sleeves."""

from typing import Annotated

from pydantic import PositiveFloat

from fem_snh.errors import bad_value
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Reaction, Rigid, Rotate, Scene
from fem_snh.tables.validation import OneOf

Kinematics = Annotated[str, OneOf(("axisymmetric_torsion", "plane_strain", "3D"))]


def bushing(
    cells: int = 4,
    inner: PositiveFloat = 10.0,
    outer: PositiveFloat = 20.0,
    length: PositiveFloat = 30.0,
    angle: float | None = None,
    torque: float | None = None,
    axial: float | None = None,
    radial: float | None = None,
    kinematics: Kinematics = "axisymmetric_torsion",
) -> Scene:
    """A rubber bushing whose outer sleeve is held and whose inner one is turned and pushed.

    Lengths are in mm, E in MPa. The axis is y; in plane strain it is z, and results are per
    thickness. At small strains, and in plane strain at any angle, an incompressible Neo-Hookean
    bushing that is turned has the torque 4 pi mu length angle / (inner^-2 - outer^-2). In plane
    strain nu is below 1/2: between two sleeves the pressure is known up to a constant only.

    Parameters
    ----------
    cells : int
        Cells through the wall.
    inner, outer : float
        Radii of the sleeves [mm].
    length : float
        Length along the axis [mm].
    angle : float, optional
        Rotation of the inner sleeve about the axis at load 1 [rad]; default: 0.5.
    torque : float, optional
        Torque on the inner sleeve [N mm], in plane strain per thickness [N], instead of the angle.
    axial : float, optional
        Displacement of the inner sleeve along the axis [mm]; default: 4, in plane strain 0.
    radial : float, optional
        Displacement of the inner sleeve along x [mm], 0 with torsion; default: 0, in plane strain
        2.
    kinematics : str
        "axisymmetric_torsion" or "plane_strain", of a section, or "3D".
    """
    flat, solid = kinematics == "plane_strain", kinematics == "3D"
    if flat and axial:
        raise bad_value("axial", axial, "0 with kinematics = 'plane_strain'")
    if radial and kinematics == "axisymmetric_torsion":
        raise bad_value("radial", radial, "0 with kinematics = 'axisymmetric_torsion'")
    if torque is not None and angle is not None:
        raise bad_value("angle", angle, "no value, with a torque")
    if axial is None:
        axial = 0.0 if flat else 4.0
    if radial is None:
        radial = 2.0 if flat else 0.0
    parameters = {"inner": inner, "outer": outer, "length": length, "section": float(not flat)}
    axis = (0, 0, 1) if flat else (0, 1, 0)
    moved, rigid = list[Move](), list[Rigid]()
    if torque is None:
        rotate = Rotate(axis=axis, angle=0.5 if angle is None else angle)
        moved = [Move(group="inner", translate=(radial, axial, 0), rotate=rotate)]
    else:
        moment = (axis[0] * torque, axis[1] * torque, axis[2] * torque)
        push = (radial, axial, 0.0)
        rigid = [
            Rigid(group="inner", torque=moment, translate=push, free=("rotation",), about=(0, 0, 0))
        ]
    return Scene(
        name="bushing",
        mesh=Geometry(source="bushing", parameters=parameters),
        cells=cells,
        element="Q2Q1",
        kinematics=None if solid else kinematics,
        steps=4,
        material=MaterialChoice(name="stable_neo_hookean", E=3.0, nu=0.499),
        hold=[Hold(group="outer")],
        move=moved,
        rigid=rigid,
        reactions=[Reaction(group="inner", about=(0, 0, 0)), Reaction(group="outer")],
    )
