"""The eigenfrequencies of a cantilever, which Chen & Barbič's Figure 1 compares at nu = 0.2."""

from pydantic import PositiveFloat

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Modes, Scene


def modes(
    cells: int = 6, aspect: PositiveFloat = 4.0, count: int = 6, density: PositiveFloat = 1000.0
) -> Scene:
    """The lowest eigenfrequencies of a clamped round bar of diameter 1 m, at rest.

    Materials of the same E and nu have the same eigenfrequencies, as their stiffness at rest is the
    same.

    Parameters
    ----------
    cells : int
        Cells along the diameter, 3 or more.
    aspect : float
        Length over diameter.
    count : int
        Number of modes, from the lowest.
    density : float
        Mass per reference volume [kg/m^3].
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
