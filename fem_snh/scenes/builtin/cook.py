"""Cook's membrane: a clamped tapered panel sheared at its free end."""

from typing import Annotated

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Probe, Reaction, Scene, Traction
from fem_snh.tables.validation import OneOf

Kinematics = Annotated[str, OneOf(("plane_strain", "plane_stress", "layer"))]


def cook(cells: int = 16, force: float = 100.0, kinematics: Kinematics = "plane_strain") -> Scene:
    """Cook's membrane in plane strain, nearly incompressible: a clamped panel sheared at its end.

    Units are N and mm, so E is in MPa. The panel is 1 mm thick. The defaults are those of Elguedj
    et al. 2008; ``force = 1``, ``E = 1.0985`` and ``nu = 0.3`` give the compressible membrane of
    deal.II's code gallery.

    Parameters
    ----------
    cells : int
        Cells along each side.
    force : float
        Total shear force on the right edge [N].
    kinematics : str
        "plane_strain", "plane_stress", or "layer": plane strain as one layer of cells in three
        dimensions, whose faces are constrained in z.
    """
    layer = kinematics == "layer"
    faces = [Hold(group="faces", components=("z",))] if layer else []
    z = 0.5 if layer else 0.0
    return Scene(
        name="cook",
        mesh=Geometry(source="cook"),
        cells=cells,
        element="Q2",
        kinematics=None if layer else kinematics,
        steps=4,
        material=MaterialChoice(name="neo_hookean_simo", E=240.565, nu=0.4999),
        hold=[Hold(group="left"), *faces],
        traction=[Traction(group="right", vector=(0, force / 16, 0))],
        reactions=[Reaction(group="left")],
        probe=[
            Probe(name="tip", point=(48, 52, z)),
            Probe(name="corner", point=(48, 60, z)),
            Probe(name="bottom", point=(24, 22, z)),
        ],
        load_name="force",
        load_range=(0, force),
    )
