"""The eigenfrequencies of a cantilever: what Chen & Barbič's Figure 1 compares at nu = 0.2."""

from pydantic import PositiveFloat

from fem_snh.scenes.schema import Geometry, Hold, MaterialChoice, Modes, Scene


def modes(
    cells: int = 6, aspect: PositiveFloat = 4.0, count: int = 6, density: PositiveFloat = 1000.0
) -> Scene:
    """A round bar of diameter 1 m, its left end held, at rest: its lowest eigenfrequencies.

    Materials of the same E and nu have the same ones, whatever their energies: stiffness is
    normalised at rest.

    Args:
        cells: along the diameter, 3 or more.
        aspect: length over diameter.
        count: how many modes, the lowest.
        density: of its mass [kg/m^3].
    """
    return Scene(
        name="modes",
        mesh=Geometry(source="cylinder", parameters={"radius": 0.5, "length": aspect}),
        cells=cells,
        element="Q2",  # Q1 is too stiff in bending
        material=MaterialChoice(name="stable_neo_hookean", E=1e6, nu=0.2),
        hold=[Hold(group="left")],
        modes=Modes(count=count, density=density),
    )
