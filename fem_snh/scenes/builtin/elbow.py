"""The elbow flexion of Smith et al. 2018, Figure 2."""

from math import radians
from typing import Annotated

from pydantic import Field, PositiveFloat

from fem_snh.scenes import BoneChoice, Geometry, MaterialChoice, Rotate, Scene


def elbow(
    cells: int = 40,
    angle: PositiveFloat = 90.0,
    biceps: Annotated[float, Field(ge=0, le=0.03)] = 0.006,
    hollow: Annotated[float, Field(ge=0, le=0.01)] = 0.01,
    thickness: Annotated[float, Field(ge=0.9, le=1.5)] = 1.0,
    order: int = 1,
) -> Scene:
    """An arm of 0.52 m whose elbow is flexed: its forearm turns with a bone in the flesh.

    Parameters
    ----------
    cells : int
        Cells along the arm: 40 give 11,200 tetrahedra.
    angle : float
        Flexion at load 1 [degrees]; the arm is straight at rest.
    biceps : float
        Height of the biceps [m].
    hollow : float
        Depth of the hollow in front of the elbow [m]. Without it the skin there is compressed until
        it forms a crease beyond 90 degrees.
    thickness : float
        Scale factor of the flesh's cross-sections.
    order : int
        2 for cells with curved faces, 1 for straight ones.
    """
    flexion = Rotate(axis=(0, -1, 0), angle=radians(angle))
    return Scene(
        name="elbow",
        mesh=Geometry(
            source="arm",
            parameters={
                "biceps": biceps,
                "hollow": hollow,
                "thickness": thickness,
                "order": order,
            },
        ),
        cells=cells,
        element="P2P0",  # nu = 0.499 does not lock
        steps=9,
        material=MaterialChoice(name="stable_neo_hookean", E=3e4, nu=0.488),
        bone=[
            BoneChoice(name="humerus", group="humerus"),
            BoneChoice(name="ulna", group="ulna", rotate=flexion),
        ],
        volumes=["flesh"],
        predictor="bones",  # 90 degrees in one step: 11 Newton iterations, with "tangent" 17
        load_name="flexion [°]",
        load_range=(0, angle),
    )
