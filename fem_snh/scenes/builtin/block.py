"""The nearly incompressible block under partial pressure of Reese, Wriggers & Reddy."""

from fem_snh.scenes.schema import Geometry, Hold, MaterialChoice, Probe, Scene, Traction

#: Lame's constants [MPa] of Schröder et al. 2021, Table 3.2.
MU, LAM = 1.61148, 499.92568


def block(cells: int = 8, pressure: float = 3.0) -> Scene:
    """A nearly incompressible block of 100 x 100 x 50 mm, pressed on a quarter of its top.

    A quarter of it is modelled, by symmetry. In N and mm: E in MPa. The bottom keeps its z, the
    top its x and y, so that the pressure stays vertical. Schröder et al. 2021, "A selection of
    benchmark problems in solid mechanics and applied mathematics", section 3.

    Args:
        cells: along each edge of the quarter, an even number.
        pressure: on the middle of the top, 50 x 50 mm [MPa].
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
        reactions=["bottom"],
        probe=[
            Probe(name="middle", point=(0, 0, 50)),
            Probe(name="rim", point=(25, 25, 50)),
            Probe(name="side", point=(50, 50, 25)),
        ],
        load_name="pressure",
        load_range=(0, pressure),
    )
