"""The pulled cube of Chen & Barbič's Figure 3."""

from pydantic import PositiveFloat

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Reaction, Scene


def pull(cells: int = 10, stretch: PositiveFloat = 2.0) -> Scene:
    """A cube of 1 m pulled apart at two opposite faces: the force as a function of the distance.

    Each step's "reactions" have the total force [N] on the right face. The figure has curves for
    several nonlinearities ``alpha`` (``--set material.alpha=1.5``), and states neither E nor nu.

    Parameters
    ----------
    cells : int
        Hexahedra along an edge; tetrahedra divide each of them into several.
    stretch : float
        Distance between the two faces at load 1 [m].
    """
    return Scene(
        name="pull",
        mesh=Geometry(source="cube"),
        cells=cells,
        element="Q1",
        steps=10,
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
        hold=[Hold(group="left")],
        move=[Move(group="right", translate=(stretch - 1, 0, 0))],
        reactions=[Reaction(group="right")],
        load_name="distance",
        load_range=(1, stretch),
    )
