"""Forces that do not depend on the displacement, scaled by amplitudes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.unknowns import add_ghosts, update_ghosts, writable_values
from fem_snh.tables.validation import is_expression
from fem_snh.terms.body import present
from fem_snh.terms.term import Term
from fem_snh.terms.ufl_term import compile_form

if TYPE_CHECKING:
    from fem_snh.assembly.nodal_mass import NodalMass

#: A factor as a function of the load parameter; `float` is the load itself.
Amplitude = Callable[[float], float]


class DeadLoad(Term):
    r"""Nodal forces, each scaled by an amplitude of the load.

    .. math:: E = -\sum_i a_i(\lambda) f_i \cdot u

    Parameters
    ----------
    name : str
        The term's name in run.json.
    V : dolfinx function space
        The displacement's space.
    """

    has_energy = depends_on_load = stateless = True
    has_hessian = False

    def __init__(self, name: str, V: _dolfinx.FunctionSpace) -> None:
        self.name, self._V = name, V
        self._forces: list[tuple[Amplitude, PETSc.Vec, Callable[[], None] | None]] = []
        self._scaled: list[tuple[float, PETSc.Vec]] = []

    def add(
        self, density: Any, measure: Any, amplitude: Amplitude = float, varies: bool = False
    ) -> None:
        """Add the force of a density over a UFL measure. Collective.

        It is assembled once, or if the density ``varies`` whenever a load is set. One form per
        load: UFL accepts one set of marked facets per form.
        """
        integral = ufl.inner(density, ufl.TestFunction(self._V)) * measure
        form = compile_form(integral, self.name)
        self._add_forces(partial(_dolfinx.assemble_vector, compiled=form), amplitude, varies)

    def add_weight(self, mass: NodalMass, acceleration: Any, amplitude: Amplitude = float) -> None:
        """Add the forces of a mass matrix times a uniform acceleration [m/s^2]. Collective.

        It has the displacement's components, numbers or a UFL expression.
        """

        def assemble(weight: PETSc.Vec) -> None:
            values = writable_values(weight)
            values[:] = mass.apply(np.resize(present(acceleration), len(values)))
            add_ghosts(weight)
            update_ghosts(weight)

        self._add_forces(assemble, amplitude, is_expression(acceleration))

    def _add_forces(
        self, assemble: Callable[[PETSc.Vec], None], amplitude: Amplitude, varies: bool
    ) -> None:
        """Add nodal forces [N], which a function assembles into a ghosted vector."""
        part = _dolfinx.create_vector(self._V)
        assemble(part)
        update = partial(assemble, part) if varies else None
        same = [force for other, force, to_update in self._forces
                if other == amplitude and not to_update]  # fmt: skip
        if same and not varies:
            same[0].axpy(1.0, part)
        else:
            self._forces.append((amplitude, part, update))
        self.set_load(0.0)

    def set_load(self, load: float) -> None:
        """Set the load parameter lambda."""
        for _, _, update in self._forces:
            if update:
                update()
        self._scaled = [(amplitude(load), force) for amplitude, force, _ in self._forces]

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the potential of the forces [J]. Collective."""
        return sum(-factor * float(force.dot(u)) for factor, force in self._scaled)

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Subtract the forces [N] from the owned entries of ``r_u``."""
        for factor, force in self._scaled:
            r_u.array[:] -= factor * force.array_r

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add nothing, and return 0: a dead load has no Hessian."""
        return 0
