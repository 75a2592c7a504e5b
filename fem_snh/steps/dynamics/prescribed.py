"""Velocity and acceleration of constrained dofs, from their prescribed displacement."""

from __future__ import annotations

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.ghosted_vectors import local_values, update_ghosts

Array = npt.NDArray[Any]

#: Points of the one-sided differences: exact for polynomials of degree 5 in time.
_POINTS = 6
#: Where the polynomial is compared with the motion: in the first and in the last interval.
_CHECKS = np.array([0.5, _POINTS - 1.5])
#: Windows of the points: distance of the first one from the time, and spacing, in the caller's
#: spacings. If a kink of an amplitude is in the first window, the next ones are closer to the time;
#: the last two leave out what is closest to it.
_WINDOWS = ((0.0, 1.0), (0.0, 1 / 8), (0.0, 1 / 64), (0.2, 1 / 8), (0.1, 1 / 64))
#: Largest misfit at the checks, relative to the change of displacement in the window, and to the
#: displacement (rounding). A kink that they hide changes the velocity by less than 1e-4 of it.
_SMOOTH, _ROUNDING = 1e-7, 1e-14


class PrescribedState(NamedTuple):
    """The motion of constrained dofs at one time; arrays (local dofs,), zero at free dofs.

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
    of the time, where it is smooth even if the time is a kink of an amplitude; at points so close
    that no kink is between them.

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
    moves : bool
        Whether a value depends on the load.
    """

    def __init__(self, V: Any, dirichlet: Dirichlet, duration: float) -> None:
        self._dirichlet, self._duration = dirichlet, duration
        self.moves = dirichlet.depends_on_load
        self._vector, self._comm = _dolfinx.create_vector(V), V.mesh.comm

    def project(self, values: Array) -> None:
        """Set what is constrained of displacements (local dofs,) to zero, in place."""
        self._dirichlet.project(values, ghosts=True)

    def displacement(self, load: float) -> Array:
        """Return the prescribed displacement [m], (local dofs,), zero at free dofs."""
        self._dirichlet.set_values(self._vector, load)
        self._vector.array[self._dirichlet.released] = 0.0
        update_ghosts(self._vector)
        return np.array(local_values(self._vector))

    def at(self, load: float, spacing: float, present: float) -> PrescribedState:
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
            return PrescribedState(u, np.zeros_like(u), np.zeros_like(u))
        found = []
        for offset, scale in _WINDOWS:
            motion, misfit = self._differences(u, load, spacing * scale, offset / scale)
            found.append((misfit, motion))
            if misfit <= 1:
                break
        self.displacement(present)
        return min(found, key=lambda pair: pair[0])[1]

    def _differences(
        self, u: Array, load: float, spacing: float, offset: float
    ) -> tuple[PrescribedState, float]:
        """Return the motion by one window of points, and its misfit, 1 if just smooth. Collective.

        The first point is ``offset`` spacings from the load, at which the displacement is u.
        """
        points = offset + np.arange(_POINTS)
        # Weights of the first two derivatives at the load, and of the values at the checks: moments
        # of the monomials (Vandermonde).
        moments = np.vander(points, increasing=True).T
        wanted = np.zeros((_POINTS, 2 + len(_CHECKS)))
        wanted[1, 0], wanted[2, 1] = 1.0, 2.0
        wanted[:, 2:] = np.vander(offset + _CHECKS, _POINTS, increasing=True).T
        weights = np.linalg.solve(moments, wanted)
        # Differences from the first value: a constant displacement has no rounding error.
        changes = [
            self.displacement(load + k * spacing) - u if k else np.zeros_like(u)
            for k in (*points, *(offset + _CHECKS))
        ]
        values, checks = np.stack(changes[:_POINTS]), np.stack(changes[_POINTS:])
        v, a, *expected = np.tensordot(weights.T, values, axes=1)
        h = spacing * self._duration
        sizes = np.array([abs(x).max(initial=0.0) for x in (checks - expected, values, u)])
        self._comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
        misfit, change, size = sizes
        allowed = _SMOOTH * change + _ROUNDING * size
        return PrescribedState(u, v / h, a / h**2), float(misfit / allowed) if misfit else 0.0
