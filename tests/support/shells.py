"""An octant of a spherical shell that is filled with fluid, and its exact pressure."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from fem_snh.scenes import Cavity, Geometry, Hold, MaterialChoice, Probe, Scene

#: Radius outside over inside, and the stretch of the inside at load 1.
THICKNESS, STRETCH = 1.5, 2.0


SYMMETRIC = [Hold(group=f"{c} = 0", components=(c,)) for c in ("x", "y", "z")]


def shell(
    hold: list[Hold], element: str = "Q2", nu: float = 0.49, steps: int = 6, **tables: Any
) -> Scene:
    """An octant of a shell that is filled with fluid."""
    octant = 4 / 3 * np.pi / 8
    return Scene(
        name="shell",
        mesh=Geometry(source="shell", parameters={"layers": 1, "outer": THICKNESS}),
        cells=2,
        element=element,
        steps=steps,
        material=MaterialChoice(name="stable_neo_hookean", E=3.0, nu=nu),
        hold=hold,
        cavity=[Cavity(group="inner", volume=octant * (STRETCH**3 - 1))],
        probe=[Probe(name="pole", point=(1, 0, 0))],
        **tables,
    )


def exact(a: float) -> float:
    """Pressure of an incompressible neo-Hookean shell, mu = 1, whose inside is stretched by a.

    The integral of dW/dl / (l^3 - 1) over the stretches of the wall, W = l^2 + l^-4/2 - 3/2.
    """
    b = (1 + (a**3 - 1) / THICKNESS**3) ** (1 / 3)

    def integrand(s: float) -> float:
        return (2 * s - 2 * s**-5) / (s**3 - 1)

    by_quadrature: float = quad(integrand, b, a)[0]
    assert by_quadrature == pytest.approx((4 / b + b**-4 - 4 / a - a**-4) / 2, rel=1e-10)
    return by_quadrature
