"""Pressures on surfaces: forces that follow the deformed normal and area."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from petsc4py import PETSc

import numpy as np

from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.errors import BadInput
from fem_snh.tables.types import surface_name
from fem_snh.tables.validation import is_expression
from fem_snh.terms.body import Body, check_expression, is_uniform, present
from fem_snh.terms.closing_surface import edge_of
from fem_snh.terms.swept_volume import SweptVolume, fit_fields
from fem_snh.terms.ufl_term import UFLTerm, UFLTerms

if TYPE_CHECKING:
    from fem_snh.terms.loads import Pressure


class FollowerPressure(UFLTerms):
    r"""Forces per deformed area, normal to the deformed surface.

    .. math:: R(u; v) = \sum_i a_i(\lambda)\, p_i \int_{\Gamma_i} \mathrm{cof}(F) N \cdot v
        \, \mathrm{d}A

    Surfaces with the same amplitude are examined together: a closed surface may be of several
    groups. If they are not conservative, the exact Hessian is not symmetric.

    Parameters
    ----------
    pressures : sequence of Pressure
        The pressures p_i [Pa] on the surfaces Gamma_i.
    body : Body
        What they act on.

    Attributes
    ----------
    has_energy : bool
        Whether the pressures are conservative: see `fem_snh.terms.swept_volume`.
    note : str
        What a user should know: which pressures are not conservative.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or not a surface.
    """

    name, depends_on_load = "pressure", True

    def __init__(self, pressures: Sequence[Pressure], body: Body) -> None:
        u, dirichlet = body.u, body.dirichlet
        self._amplitudes = [body.amplitudes.force(load.table) for load in pressures]
        given = [load.value if is_expression(load.value) else 1.0 for load in pressures]
        for value in filter(is_expression, given):
            check_expression("pressure.value", value, u)
        #: The pressures at amplitude 1 are numbers times expressions.
        self._numbers = [1.0 if is_expression(load.value) else load.value for load in pressures]
        self._expressions = given
        self._present = [body.constant(0.0) for _ in pressures]
        self._volumes = [
            SweptVolume(body.V, body.surface("pressure.group", load.group), body.kinematics)
            for load in pressures
        ]
        parts = zip(self._present, given, self._volumes, strict=True)
        self._terms = [UFLTerm(p * v.residual(u, q), u, self.name) for p, q, v in parts]
        # Pressures vary in proportion that have one amplitude and one expression.
        factors = list(zip(self._amplitudes, given, strict=True))
        causes: dict[str, list[str]] = {}
        for factor in dict.fromkeys(factors):
            which = [i for i, other in enumerate(factors) if other == factor]
            cause = ""
            if not is_uniform(factor[1]):
                cause = "as it varies over the surface"
            elif not self._fit(which, dirichlet):
                facets = [body.facets("pressure.group", pressures[i].group) for i in which]
                edge = edge_of(body.V, np.concatenate(facets), dirichlet, body.kinematics.dim)
                cause = "as an edge of the surface is free"
                if edge.on_parts.any():
                    cause = "as it ends on a rigid part, on which it does not act"
            names = [f"'{surface_name(pressures[i].group)}'" for i in which]
            causes.setdefault(cause, []).extend(names)
        causes.pop("", None)
        self.has_energy = self.symmetric = not causes
        texts = [
            f"the pressure on {', '.join(on)} has no energy, {why}" for why, on in causes.items()
        ]
        self.note = f"{'; '.join(texts)}: the line search is on the residual" if texts else ""

    def _fit(self, which: Sequence[int], dirichlet: Dirichlet) -> bool:
        """Set the fields of some surfaces; whether the pressures on them are conservative."""
        volumes, values = [self._volumes[i] for i in which], [self._numbers[i] for i in which]
        fields = fit_fields(volumes, values, dirichlet)
        for volume, field in zip(volumes, [] if fields is None else fields, strict=False):
            volume.set_field(field)
        return fields is not None

    def set_load(self, load: float) -> None:
        """Set the pressures of a load."""
        factors = zip(self._present, self._numbers, self._amplitudes, strict=True)
        for factor, number, amplitude in factors:
            factor.value = np.array(number * amplitude(load))
        for term in self._terms:
            term.set_load(load)

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the potential of the pressures [J], zero at rest. Collective.

        Raises
        ------
        BadInput
            If the pressures are not conservative.
        """
        if not self.has_energy:
            raise BadInput(self.note)
        parts = zip(self._present, self._expressions, self._volumes, strict=True)
        return sum(float(p.value * present(q)) * v.change(u) for p, q, v in parts)
