"""Velocity and acceleration of constrained dofs, from their prescribed displacement."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.fem.boundary_conditions import Dirichlet
from fem_snh.fem.ghosted_vectors import local_values, update_ghosts

Array = npt.NDArray[Any]

#: Points of the one-sided differences: exact for polynomials of degree 5 in time.
_POINTS = 6


class Motion(NamedTuple):
    """The motion of constrained dofs at one time; arrays (3 local nodes,), zero at free dofs.

    Attributes
    ----------
    u, v, a : arrays
        Displacement [m], velocity [m/s] and acceleration [m/s^2].
    """

    u: Array
    v: Array
    a: Array


class PrescribedMotion:
    """The motion of constrained dofs as a function of the load. Collective.

    A time integrator's formulas make velocities and accelerations of prescribed displacements ring
    (Newmark) or lag (backward Euler). These are differences of the displacement itself, on one side
    of the time, where it is smooth even if the time is a kink of an amplitude.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    dirichlet : Dirichlet
        The constrained dofs and their values.
    duration : float
        The time [s] in which the load goes from 0 to 1.

    Attributes
    ----------
    constrained : (3 local nodes,) bool
        The constrained dofs, ghosts included.
    moves : bool
        Whether a value depends on the load.
    """

    def __init__(self, V: Any, dirichlet: Dirichlet, duration: float) -> None:
        self._dirichlet, self._duration = dirichlet, duration
        self.constrained: Array = dirichlet.constrained.ravel()
        self.moves = dirichlet.depends_on_load
        self._vector = _dolfinx.create_vector(V)

    def displacement(self, load: float) -> Array:
        """Return the prescribed displacement [m], (3 local nodes,), zero at free dofs."""
        self._dirichlet.set_values(self._vector, load)
        update_ghosts(self._vector)
        return np.array(local_values(self._vector))

    def at(self, load: float, spacing: float, present: float) -> Motion:
        """Return the motion at a load.

        Parameters
        ----------
        load : float
            The load, 0 to 1.
        spacing : float
            Spacing of the differences' points, in load: negative for points at lower loads.
        present : float
            The problem's load: values that a program sets as a function of time are left there.
        """
        u = self.displacement(load)
        if not self.moves:
            return Motion(u, np.zeros_like(u), np.zeros_like(u))
        steps = np.arange(_POINTS)
        # Weights of the first two derivatives at point 0: moments of the monomials (Vandermonde).
        moments = np.vander(steps, increasing=True).T.astype(float)
        derivatives = np.zeros((_POINTS, 2))
        derivatives[1, 0], derivatives[2, 1] = 1.0, 2.0
        weights = np.linalg.solve(moments, derivatives)
        h = spacing * self._duration
        # Differences from the first value: a constant displacement has no rounding error.
        changes = [self.displacement(load + k * spacing) - u for k in steps[1:]]
        self.displacement(present)
        v, a = np.tensordot(weights[1:].T, np.stack(changes), axes=1)
        return Motion(u, v / h, a / h**2)
