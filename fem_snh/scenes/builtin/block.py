"""The nearly incompressible block under partial pressure of Reese, Wriggers & Reddy."""

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Probe, Reaction, Scene, Traction

#: Lame's constants [MPa] of Schröder et al. 2021, Table 3.2.
MU, LAM = 1.61148, 499.92568


def block(cells: int = 8, pressure: float = 3.0) -> Scene:
    """A nearly incompressible block of 100 x 100 x 50 mm, pressed on a quarter of its top.

    By symmetry, a quarter of the block is modelled. Units are N and mm, so E is in MPa. The bottom
    is constrained in z, the top in x and y, so that the pressure stays vertical.

    Parameters
    ----------
    cells : int
        Cells along each edge of the quarter, an even number.
    pressure : float
        Pressure on the middle of the top, 50 x 50 mm [MPa].

    References
    ----------
    Schröder et al. 2021, "A selection of benchmark problems in solid mechanics and applied
    mathematics", section 3.
    """
    return Scene(
        name="block",
        mesh=Geometry(source="block", parameters={"side": 50, "height": 50}),
        cells=cells,
        element="Q2",
        steps=4,
        material=MaterialChoice(
            name="neo_hookean_ogden",
            E=MU * (3 * LAM + 2 * MU) / (LAM + MU),
            nu=LAM / (2 * (LAM + MU)),
        ),
        hold=[
            Hold(group="bottom", components=("z",)),
            Hold(group="top", components=("x", "y")),
            Hold(group="left", components=("x",)),
            Hold(group="front", components=("y",)),
        ],
        traction=[Traction(group="patch", vector=(0, 0, -pressure))],
        reactions=[Reaction(group="bottom")],
        probe=[
            Probe(name="middle", point=(0, 0, 50)),
            Probe(name="rim", point=(25, 25, 50)),
            Probe(name="side", point=(50, 50, 25)),
        ],
        load_name="pressure",
        load_range=(0, pressure),
    )
