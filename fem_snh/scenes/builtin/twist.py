"""The twisted cube of Smith et al. 2018, Figure 9."""

from math import pi

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Probe, Reaction, Rotate, Scene


def twist(cells: int = 15, angle: float = pi) -> Scene:
    """A unit cube, fixed at the bottom, whose top is turned by a quarter turn in each of two steps.

    Parameters
    ----------
    cells : int
        Hexahedra along an edge; tetrahedra divide each of them into several.
    angle : float
        Rotation of the top at load 1 [rad], about the vertical axis through the centre.
    """
    return Scene(
        name="twist",
        mesh=Geometry(source="cube"),
        cells=cells,
        element="Q1",
        steps=2,
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.49),
        hold=[Hold(group="bottom")],
        move=[
            Move(
                group="top",
                rotate=Rotate(axis=(0, 0, 1), through=(0.5, 0.5, 0.5), angle=angle),
            )
        ],
        reactions=[Reaction(group="top")],
        probe=[
            Probe(name="side", point=(1, 0.5, 0.5)),
            Probe(name="edge", point=(1, 1, 0.5)),
            Probe(name="inside", point=(0.75, 0.5, 0.75)),
        ],
        predictor="none",  # the response to a quarter turn is not linear
        # With looser linear solves, rounding decides how inverted cells unfold.
        petsc={"snes_forcing_max": 5e-3},
        load_name="angle",
        load_range=(0, angle),
    )
