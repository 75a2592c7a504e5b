"""A thick-walled tube under pressure, with the exact solution of an incompressible one."""

from math import log
from typing import Annotated

from pydantic import PositiveFloat

from fem_snh.scenes import Geometry, MaterialChoice, Pressure, Probe, Scene, Symmetry
from fem_snh.tables.validation import OneOf

Kinematics = Annotated[str, OneOf(("plane_strain", "axisymmetric"))]


def inflation_pressure(stretch: float, inner: float, outer: float) -> float:
    r"""Return the pressure, over mu, that stretches the inner radius of a long incompressible tube.

    With radii A, B at rest and a, b inflated, :math:`b^2 - a^2 = B^2 - A^2`, the equilibrium of a
    Neo-Hookean tube of constant length is (Ogden 1997, section 5.3)

    .. math:: p / \mu = \ln (B/A) - \ln (b/a) + (a^2 - A^2) (a^{-2} - b^{-2}) / 2 .
    """
    a = stretch * inner
    b = (outer**2 + a**2 - inner**2) ** 0.5
    change = a**2 - inner**2
    return log(outer / inner) - log(b / a) + change / 2 * (1 / a**2 - 1 / b**2)


def tube(
    cells: int = 8,
    inner: PositiveFloat = 1.0,
    outer: PositiveFloat = 2.0,
    inflation: PositiveFloat = 1.5,
    kinematics: Kinematics = "plane_strain",
    order: int = 2,
) -> Scene:
    """A thick-walled rubber tube, inflated to 1.5 times its inner radius at constant length.

    The pressure is that of the exact solution for an incompressible Neo-Hookean tube: the probes'
    radial displacements are then known.

    Parameters
    ----------
    cells : int
        Cells through the wall.
    inner, outer : float
        Radii at rest.
    inflation : float
        Inner radius of an incompressible tube at load 1 over its inner radius at rest.
    kinematics : str
        "plane_strain", a quarter of the cross-section, or "axisymmetric", a slice of length 1.
    order : int
        2 for cells with curved sides, 1 for straight ones.
    """
    section = kinematics == "axisymmetric"
    radii = {"inner": inner, "outer": outer}
    pressure = inflation_pressure(inflation, inner, outer)
    return Scene(
        name="tube",
        mesh=Geometry(source="tube", parameters={**radii, "section": int(section), "order": order}),
        cells=cells,
        element="Q2Q1",
        kinematics=kinematics,
        steps=4,
        material=MaterialChoice(name="stable_neo_hookean", E=3.0, nu=0.5),
        symmetry=[Symmetry(group="start"), Symmetry(group="end")],
        pressure=[Pressure(group="inner", value=pressure)],
        probe=[Probe(name=name, point=(radius, 0, 0)) for name, radius in radii.items()],
        load_name="pressure",
        load_range=(0, pressure),
    )
