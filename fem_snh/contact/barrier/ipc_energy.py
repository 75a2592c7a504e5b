"""The barrier of a surface's points, with its derivatives: no MPI, no finite elements."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.contact.barrier.ipc_friction import SurfaceFriction
from fem_snh.contact.barrier.ipc_surface import CollisionSurface
from fem_snh.terms.settling import relative

Array = npt.NDArray[Any]

#: The sparsity pattern has all pairs within this many activation distances.
_PATTERN = 2.0
#: Friction has settled when new normal forces change its forces by less than this fraction of them.
_SETTLED = 1e-3


class BarrierEnergy:
    r"""The energy of a barrier between all parts of a surface, and of friction. Not collective.

    .. math:: E = \kappa \hat d \sum_k w_k\, b(d_k/\hat d), \qquad
        b(s) = -(s^2 - 1)^2 \ln s^2 \quad \text{for}\ s < 1

    over pairs of points, edges and triangles of distance d_k and area w_k (Li et al. 2020, eq. 6;
    Li et al. 2023 for the areas). Points ``x`` are (n, 3) [m].

    Parameters
    ----------
    surface : CollisionSurface
        The surface.
    stiffness : float
        The stiffness kappa [Pa].
    distance : float
        The activation distance [m].
    friction : float
        Coulomb's coefficient.

    Attributes
    ----------
    friction : SurfaceFriction
        The energy of friction.
    """

    def __init__(
        self, surface: CollisionSurface, stiffness: float, distance: float, friction: float
    ) -> None:
        self._surface, self._distance, self._coefficient = surface, distance, friction
        ipctk = surface.ipctk
        self._barrier = ipctk.BarrierPotential(distance, stiffness, True)
        projections = ipctk.PSDProjectionMethod
        self._projections = {
            "exact": projections.NONE,
            "clamp": projections.CLAMP,
            "abs": projections.ABS,
        }
        self.friction = SurfaceFriction(surface, friction, distance)
        self._last: tuple[Array, Any] | None = None

    def collisions(self, x: Array) -> Any:
        """Return the ipctk.NormalCollisions at points x, of the last call if x is the same."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x, self._surface.collisions(x, self._distance)
        return self._last[1]

    def energy(self, x: Array) -> float:
        """Return the energy of the barrier, without friction [J]."""
        return float(self._barrier(self.collisions(x), self._surface.mesh, x))

    def gradient(self, x: Array) -> Array:
        """Return the derivative of the energy and of that of friction, (n, 3) [N]."""
        found = self._barrier.gradient(self.collisions(x), self._surface.mesh, x)
        return np.asarray(found).reshape(-1, 3) + self.friction.gradient(x)

    def hessian(self, x: Array, filter: str) -> Any:
        """Return the filtered second derivative [N/m], a sparse (3 n, 3 n) matrix."""
        projection = self._projections[filter]
        found = self._barrier.hessian(self.collisions(x), self._surface.mesh, x, projection)
        return found + self.friction.hessian(x, projection) if self.friction.acts else found

    def pattern(self, x: Array) -> Any:
        """Return a sparse matrix of ones, where the Hessian of a wider barrier has entries."""
        wide = _PATTERN * self._distance
        barrier = self._surface.ipctk.BarrierPotential(wide, 1.0, True)
        found = barrier.hessian(self._surface.collisions(x, wide), self._surface.mesh, x)
        found.data[:] = 1.0
        return found

    def begin_step(self, x: Array) -> None:
        """Start the slip of a step at points x; `lag` gives it forces."""
        self._surface.forget()
        self._last = None
        self.friction.begin_step(x)

    def lag(self, x: Array) -> None:
        """Set the normal forces of friction to those at points x."""
        self.friction.lag(x, self.collisions(x), self._barrier)

    def settle(self, x: Array) -> float:
        """Update the normal forces of friction; return the change of its forces, in its tolerance.

        They are kept where the change is below the tolerance.
        """
        change = self.friction.change(x, self.collisions(x), self._barrier)
        normal = self.gradient(x) - self.friction.gradient(x)
        ratio = relative(change, self._coefficient * float(np.linalg.norm(normal)), _SETTLED)
        if not ratio <= 1:
            self.lag(x)
        return ratio
