"""Coulomb friction of a surface with itself, with normal forces and tangent planes lagged."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.contact.barrier.ipc_surface import CollisionSurface

Array = npt.NDArray[Any]

#: Slip of a step below which surfaces stick, in activation distances: far below what is seen, and
#: large enough that Newton's method meets no kink.
_STICKING = 0.05


class SurfaceFriction:
    r"""The energy of friction in a step, of the displacement since its start. Not collective.

    With the lagged normal force :math:`\ell_k` of a collision and its tangential displacement s_k,

    .. math:: E = \sum_k \mu \ell_k f_0(|s_k|), \qquad
        f_0'(y) = \begin{cases} 2 y/\epsilon - y^2/\epsilon^2 & y < \epsilon \\ 1 \end{cases}

    (Li et al. 2020, eq. 13 to 16).

    Parameters
    ----------
    surface : CollisionSurface
        The surface.
    coefficient : float
        Coulomb's coefficient mu.
    distance : float
        The barrier's activation distance [m].
    """

    def __init__(self, surface: CollisionSurface, coefficient: float, distance: float) -> None:
        self._surface, self._mu, self._ipctk = surface, coefficient, surface.ipctk
        self._potential = self._ipctk.FrictionPotential(_STICKING * distance)
        self._start: Array = np.zeros(0)
        self._collisions = self._ipctk.TangentialCollisions()

    @property
    def acts(self) -> bool:
        """Whether there is a collision with friction."""
        return not self._collisions.empty()

    def begin_step(self, x: Array) -> None:
        """Start a step at points x (n, 3) [m], without forces until `lag`."""
        self._start = np.array(x)
        self._collisions = self._ipctk.TangentialCollisions()

    def lag(self, x: Array, collisions: Any, barrier: Any) -> None:
        """Set normal forces and tangent planes to those of collisions at points x (n, 3)."""
        if self._mu > 0:
            self._collisions = self._lagged(x, collisions, barrier)

    def change(self, x: Array, collisions: Any, barrier: Any) -> float:
        """Return the norm of how `lag` would change the forces at x [N]."""
        if not self._mu > 0:
            return 0.0
        after = self._gradient(self._lagged(x, collisions, barrier), x)
        return float(np.linalg.norm(after - self.gradient(x)))

    def energy(self, x: Array) -> float:
        """Return the energy [J] at points x (n, 3)."""
        if not self.acts:
            return 0.0
        return float(self._potential(self._collisions, self._surface.mesh, self._slip(x)))

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative [N] by the points, (n, 3)."""
        return self._gradient(self._collisions, x) if self.acts else np.zeros(x.shape)

    def hessian(self, x: Array, projection: Any) -> Any:
        """Return the projected second derivative [N/m], a sparse (3 n, 3 n) matrix."""
        mesh = self._surface.mesh
        return self._potential.hessian(self._collisions, mesh, self._slip(x), projection)

    def _lagged(self, x: Array, collisions: Any, barrier: Any) -> Any:
        found = self._ipctk.TangentialCollisions()
        mesh, points = self._surface.mesh, np.asfortranarray(x)
        found.build(mesh, points, collisions, barrier, self._mu)
        return found

    def _gradient(self, collisions: Any, x: Array) -> Array:
        mesh, slip = self._surface.mesh, self._slip(x)
        return np.asarray(self._potential.gradient(collisions, mesh, slip)).reshape(-1, 3)

    def _slip(self, x: Array) -> Array:
        """Return the displacement since the start of the step."""
        return np.asfortranarray(x - self._start)
