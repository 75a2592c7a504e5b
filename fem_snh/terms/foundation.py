"""Elastic foundations: forces on surfaces, opposite to the displacement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh.tables.validation import is_expression
from fem_snh.terms.ufl_term import UFLTerm, UFLTerms

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.loads import Spring


class Foundation(UFLTerms):
    r"""Foundations that resist the displacement of surfaces (Robin conditions).

    .. math:: E = \sum_i \frac{a_i(\lambda)}{2} \int_{\Gamma_i} k_i u \cdot u \, \mathrm{d}A

    Parameters
    ----------
    springs : sequence of Spring
        The stiffnesses k_i [Pa/m] on the surfaces Gamma_i, and the factors a_i >= 0.
    body : Body
        What they act on.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or not a surface.
    """

    name, has_energy = "spring", True

    def __init__(self, springs: Sequence[Spring], body: Body) -> None:
        follows = body.dirichlet.depends_on_load
        self.depends_on_load = any(
            spring.table is not None or (follows and is_expression(spring.stiffness))
            for spring in springs
        )
        self._amplitudes = [
            None if spring.table is None else body.amplitudes.force(spring.table)
            for spring in springs
        ]
        self._factors, self._terms = [body.constant(1.0) for _ in springs], []
        components = body.kinematics.components
        for spring, factor in zip(springs, self._factors, strict=True):
            key, k = "spring.stiffness", spring.stiffness
            if is_expression(k):
                k = body.expression(key, k)
            else:
                each = k if isinstance(k, tuple) else (k,) * components
                k = body.constant(np.array(body.components(key, each), float))
            forces = [(k[i] if k.ufl_shape else k) * body.u[i] for i in range(components)]
            energy = factor * ufl.inner(ufl.as_vector(forces), body.u) / 2
            ds = body.measure("spring.group", spring.group)
            self._terms.append(UFLTerm(energy * ds, body.u, self.name))

    def set_load(self, load: float) -> None:
        """Set the factors of the stiffnesses."""
        for factor, amplitude in zip(self._factors, self._amplitudes, strict=True):
            factor.value = np.array(1.0 if amplitude is None else amplitude(load))

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of the foundations [J]. Collective."""
        return sum(term.energy(u, p) for term in self._terms)
