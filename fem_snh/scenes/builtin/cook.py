"""Cook's membrane: a clamped tapered panel sheared at its free end."""

from fem_snh.scenes.schema import Geometry, Hold, MaterialChoice, Probe, Reaction, Scene, Traction


def cook(cells: int = 16, force: float = 100.0, kinematics: str | None = None) -> Scene:
    """Cook's membrane in plane strain, nearly incompressible: a clamped panel sheared at its end.

    Units are N and mm, so E is in MPa. The panel is 1 mm thick: one layer of cells whose faces are
    constrained in z. The defaults are those of Elguedj et al. 2008; ``force = 1``, ``E = 1.0985``
    and ``nu = 0.3`` give the compressible membrane of deal.II's code gallery.

    Parameters
    ----------
    cells : int
        Cells along each side.
    force : float
        Total shear force on the right edge [N].
    kinematics : str, optional
        "plane_strain" or "plane_stress" for a mesh of two dimensions in place of the layer.
    """
    faces = [] if kinematics else [Hold(group="faces", components=("z",))]
    z = 0.0 if kinematics else 0.5
    return Scene(
        name="cook",
        mesh=Geometry(source="cook"),
        cells=cells,
        element="Q2",
        kinematics=kinematics,
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
