"""The balance of inertia, damping and all other forces of a problem at one state."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.fem.ghosted_vectors import add_ghosts, local_values, update_ghosts, writable_values
from fem_snh.fem.integrators import Affine
from fem_snh.fem.nodal_mass import NodalMass
from fem_snh.fem.problem import Problem
from fem_snh.fem.terms import Term
from fem_snh.fem.terms.damping import Damping
from fem_snh.fem.terms.inertia import Inertia

Array = npt.NDArray[Any]


class ForceBalance:
    """The terms of inertia and damping, and the other forces without them.

    Parameters
    ----------
    mass : NodalMass
        The mass matrix.
    damping : tuple of float
        Rayleigh damping: the factors of the mass [1/s] and of the stiffness [s].

    Attributes
    ----------
    inertia, damping : Inertia, Damping or None
        The terms; damping only if a factor is not zero.
    """

    def __init__(self, mass: NodalMass, damping: tuple[float, float]) -> None:
        self._mass, self.inertia = mass, Inertia(mass)
        self.damping = Damping(mass, damping) if any(damping) else None
        self._stiffness_is_current = False

    @property
    def terms(self) -> list[Term]:
        """The terms that exist."""
        return [self.inertia, *([self.damping] if self.damping else [])]

    def set_formulas(self, acceleration: Affine | None, velocity: Affine | None) -> None:
        """Set what the terms' acceleration and velocity are; None leaves the terms out."""
        self.inertia.acceleration = acceleration
        if self.damping:
            self.damping.velocity = velocity

    def outdate_stiffness(self) -> None:
        """Let `update_stiffness` assemble: the state has changed."""
        self._stiffness_is_current = False

    def update_stiffness(self, problem: Problem) -> None:
        """Assemble the damping stiffness at the present state, unless current. Collective."""
        if not (self.damping and self.damping.has_stiffness) or self._stiffness_is_current:
            return
        u, p = problem.split(problem.x)
        self.damping.update_stiffness(
            problem.matrix,
            problem.x,
            u,
            lambda target: problem.elastic.add_hessian(u, p, "clamp", target),
        )
        self._stiffness_is_current = True

    def forces(self, problem: Problem, v: Array, a: Array | None = None) -> Array:
        """Return the forces f + C v + M a [N] at the present state. Collective.

        Parameters
        ----------
        problem : Problem
            The problem, at the state.
        v, a : (3 local nodes,)
            Velocity, and acceleration if inertia is to be included.

        Returns
        -------
        (3 owned nodes,)
            At constrained dofs, with a, the forces that the constraints exert.
        """
        r = problem.x.duplicate()
        with self._without_terms():
            problem.gradient(problem.x, r)
        local = np.zeros_like(v)
        if self.damping:
            self.update_stiffness(problem)
            local += self.damping.apply(v)
        if a is not None:
            local += self._mass.apply(a)
        return np.asarray(r.array_r[: self._mass.num_owned] + self._summed(problem, local))

    def acceleration(self, problem: Problem, v: Array, prescribed: Array) -> Array:
        """Return the acceleration that balances the forces at the present state. Collective.

        Parameters
        ----------
        problem : Problem
            The problem, at the state. Its matrix is overwritten.
        v : (3 local nodes,)
            The velocity.
        prescribed : (3 local nodes,)
            The acceleration of constrained dofs, zero at others.

        Returns
        -------
        (3 local nodes,)
        """
        force = -self.forces(problem, v, prescribed)
        found = _dolfinx.create_vector(problem.V)
        found.array[:] = self._mass.solve(problem.matrix, problem.constrained_dofs, force)
        update_ghosts(found)
        return prescribed + local_values(found)

    def _summed(self, problem: Problem, local: Array) -> Array:
        """Return the sum over ranks of their parts of nodal forces, (3 owned nodes,)."""
        vector = _dolfinx.create_vector(problem.V)
        writable_values(vector)[:] = local
        add_ghosts(vector)
        return np.array(vector.array_r)

    @contextmanager
    def _without_terms(self) -> Iterator[None]:
        kept = self.inertia.acceleration, self.damping.velocity if self.damping else None
        self.set_formulas(None, None)
        try:
            yield
        finally:
            self.set_formulas(*kept)
