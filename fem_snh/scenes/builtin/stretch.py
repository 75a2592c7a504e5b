"""The stretched cylinder of Smith et al. 2018, Figure 6."""

from pydantic import PositiveFloat

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Probe, Reaction, Scene


def stretch(
    cells: int = 12,
    stretch: PositiveFloat = 3.4,
    aspect: PositiveFloat = 1.0,
    kinematics: str | None = None,
    order: int = 1,
) -> Scene:
    """A cylinder of diameter 1, clamped at both ends, stretched to 3.4 times its length.

    Parameters
    ----------
    cells : int
        Cells along the diameter, 3 or more; 71 gives the resolution of Smith et al. 2018 (302,247
        hexahedra).
    stretch : float
        Length at load 1 over length at rest.
    aspect : float
        Length at rest over diameter.
    kinematics : str, optional
        "axisymmetric" for a mesh of two dimensions that revolves about the y axis.
    order : int
        2 for cells with curved sides in three dimensions, 1 for straight ones.
    """
    along, radius = (stretch - 1) * aspect, 0.125**0.5
    translate = (0, along, 0) if kinematics else (along, 0, 0)
    axis = (0, aspect / 4, 0) if kinematics else (aspect / 4, 0, 0)
    inside = (radius, aspect / 2, 0) if kinematics else (aspect / 2, 0.25, 0.25)
    cylinder = {"radius": 0.5, "length": aspect, "order": order}
    return Scene(
        name="stretch",
        mesh=Geometry(source="cylinder", parameters=cylinder),
        cells=cells,
        element="Q1",
        kinematics=kinematics,
        steps=12,
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.49),
        hold=[Hold(group="left")],
        move=[Move(group="right", translate=translate)],
        reactions=[Reaction(group="right")],
        probe=[
            Probe(name="axis", point=axis),
            Probe(name="inside", point=inside),
        ],
        load_name="stretch",
        load_range=(1, stretch),
    )
