"""Cook's membrane: a clamped tapered panel sheared at its free end."""

from fem_snh.scenes.schema import Geometry, Hold, MaterialChoice, Probe, Scene, Traction


def cook(cells: int = 16, force: float = 100.0) -> Scene:
    """Cook's membrane in plane strain, nearly incompressible: a clamped panel sheared at its end.

    In N and mm: E in MPa. As in Elguedj et al. 2008; with ``force=1 --E 1.0985 --nu 0.3`` the
    compressible one of deal.II's code gallery. The thickness of 1 mm is one layer of cells whose
    faces keep their z.

    Args:
        cells: along each side.
        force: total shear on the right edge [N].
    """
    return Scene(
        name="cook",
        mesh=Geometry(source="cook"),
        cells=cells,
        element="Q2",
        steps=4,
        material=MaterialChoice(name="neo_hookean_simo", E=240.565, nu=0.4999),
        hold=[Hold(group="left"), Hold(group="faces", components=("z",))],
        traction=[Traction(group="right", vector=(0, force / 16, 0))],
        reactions=["left"],
        probe=[
            Probe(name="tip", point=(48, 52, 0.5)),
            Probe(name="corner", point=(48, 60, 0.5)),
            Probe(name="bottom", point=(24, 22, 0.5)),
        ],
        load_name="force",
        load_range=(0, force),
    )
