"""The weight of a body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.ghosted_vectors import add_ghosts, update_ghosts, writable_values
from fem_snh.assembly.regions import Region, cell_constant, density_of
from fem_snh.terms.dead_load import Amplitude, DeadLoad

if TYPE_CHECKING:
    from fem_snh.assembly.nodal_mass import NodalMass


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
    mass : NodalMass, optional
        The mass matrix M of a body in motion, for the forces M g: with a lumped one a body falls
        without being deformed. Without, those of the integral.

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
        mass: NodalMass | None = None,
    ) -> None:
        super().__init__("gravity", V)
        if mass is not None:
            weight = _dolfinx.create_vector(V)
            uniform = np.tile(np.asarray(vector, dtype=float), len(writable_values(weight)) // 3)
            writable_values(weight)[:] = mass.apply(uniform)
            add_ghosts(weight)
            update_ghosts(weight)
            self.add_forces(weight, amplitude)
            self.set_load(0.0)
            return
        densities = [density_of(region, "gravity") for region in regions]
        density = cell_constant(V.mesh, regions, densities)
        weight = density * _dolfinx.constant(V.mesh, vector)
        self.add(ufl.inner(weight, ufl.TestFunction(V)) * ufl.dx, amplitude)
        self.set_load(0.0)
