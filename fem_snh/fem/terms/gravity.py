"""The weight of a body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ufl

from fem_snh import _dolfinx
from fem_snh.errors import BadInput
from fem_snh.fem.regions import Region
from fem_snh.fem.terms.dead_load import Amplitude, DeadLoad


class Gravity(DeadLoad):
    r"""A uniform acceleration of the whole body.

    .. math:: E = -a(\lambda) \int_\Omega \rho\, g \cdot u \, \mathrm{d}V

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    regions : sequence of Region
        The cells and their densities rho [kg/m^3].
    vector : sequence of float
        The acceleration g [m/s^2].
    amplitude : callable, optional
        The factor a as a function of the load; without, the load itself.

    Raises
    ------
    BadInput
        On every rank, if a material has no density.
    """

    def __init__(
        self,
        V: Any,
        regions: Sequence[Region],
        vector: Sequence[float],
        amplitude: Amplitude = float,
    ) -> None:
        super().__init__("gravity", V)
        density = _dolfinx.function(_dolfinx.function_space(V.mesh, 0, family="DG"), "density")
        dofs = _dolfinx.node_dofs(density.function_space)[:, 0]
        for region in regions:
            if region.density is None:
                name = region.material.name
                raise BadInput(
                    f"missing key 'material.density' of {name}: expected a number > 0, for gravity"
                )
            density.x.array[dofs[region.cells]] = region.density
        weight = density * _dolfinx.constant(V.mesh, vector)
        self.add(ufl.inner(weight, ufl.TestFunction(V)) * ufl.dx, amplitude)
        self.set_load(0.0)
