"""Velocity and acceleration of constrained dofs, from their prescribed displacement."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.unknowns import local_values, update_ghosts
from fem_snh.geometry.motions import path_rates
from fem_snh.steps.dynamics.integrators import BDF2, MotionState

if TYPE_CHECKING:
    from fem_snh.terms.rigid_parts import RigidParts


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
    (Newmark) or lag (backward Euler). Here they are the differences of `path_rates`, or for values
    that a program changes from step to step by hand, backward differences of second order.

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
        Whether a value may change.
    by_hand : bool
        Whether a program changes values from step to step.
    """

    def __init__(self, V: _dolfinx.FunctionSpace, dirichlet: Dirichlet, duration: float) -> None:
        self._V, self._dirichlet, self._duration = V, dirichlet, duration
        self._depends_on_load, self.by_hand = dirichlet.depends_on_load, dirichlet.by_hand
        self.moves = dirichlet.depends_on_load or dirichlet.by_hand
        self._vector = _dolfinx.create_vector(V)
        self._rigid: RigidParts | None = None
        #: The local dofs, and the owned dofs, of rigid parts whose whole motion is prescribed.
        self._of_parts = self._own_of_parts = np.empty(0, np.int64)

    def add_parts(self, rigid: RigidParts | None) -> None:
        """Add the rigid parts whose whole motion is prescribed; do nothing without rigid parts."""
        parts = self._dirichlet.rigid_parts
        if rigid is None or parts is None:
            return
        on_parts = np.isin(parts, rigid.prescribed_parts)
        dofs = np.flatnonzero(np.repeat(on_parts, _dolfinx.num_components(self._V)))
        self._rigid, self._of_parts = rigid, dofs
        self._own_of_parts = dofs[dofs < self._vector.getLocalSize()]

    def project(self, values: Array) -> None:
        """Set constrained directions of displacements (local dofs,) to zero, in place."""
        self._dirichlet.project(values, ghosts=True)
        values[self._of_parts] = 0.0

    def displacement(self, load: float) -> Array:
        """Return the prescribed displacement [m], (local dofs,), zero at free dofs. Collective.

        Constants and functions of a program are set for ``load``.
        """
        self._dirichlet.set_values(self._vector, load)
        self._vector.array[self._dirichlet.released] = 0.0
        if self._rigid:
            self._vector.array[self._own_of_parts] = self._rigid.prescribed_displacement(load)
        update_ghosts(self._vector)
        return np.array(local_values(self._vector))

    def at(self, load: float, step: float, present: float) -> PrescribedState:
        """Return the motion at a load by `path_rates`: not for values changed by hand. Collective.

        Parameters
        ----------
        load, step : float
            As for `path_rates`.
        present : float
            The problem's load, for which constants of a program are set again.
        """
        if not self._depends_on_load and not self._rigid:
            u = self.displacement(load)
            return PrescribedState(u, np.zeros_like(u), np.zeros_like(u))
        u, v, a = path_rates(self.displacement, load, step)
        self.displacement(present)
        return PrescribedState(u, v / self._duration, a / self._duration**2)

    def after(self, state: MotionState, load: float, present: float) -> PrescribedState:
        """Return the motion at ``load``, one step after ``state`` at the load ``present``."""
        if not self.by_hand:
            return self.at(load, load - present, present)
        u = self.displacement(load)
        # Changes from the state: a constant displacement has no rounding error.
        before = state.before and state.before._replace(u=state.before.u - state.u)
        change = MotionState(np.zeros_like(u), state.v, state.a, before)
        formulas = BDF2().formulas((load - present) * self._duration, change)
        v, a = formulas.velocity(u - state.u), formulas.acceleration(u - state.u)
        if self._rigid:  # the motions of parts are known at all loads
            of_parts, known = self._of_parts, self.at(load, load - present, present)
            v[of_parts], a[of_parts] = known.v[of_parts], known.a[of_parts]
        return PrescribedState(u, v, a)
