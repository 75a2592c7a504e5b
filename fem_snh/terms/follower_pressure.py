"""Pressures on surfaces: forces that follow the deformed normal and area."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.tables.types import surface_name
from fem_snh.tables.validation import is_expression
from fem_snh.terms.body import Body, check_expression, is_uniform, present
from fem_snh.terms.closing_surface import ClosingSurface, NotClosedError
from fem_snh.terms.swept_volume import SweptVolume
from fem_snh.terms.ufl_term import UFLTerms

if TYPE_CHECKING:
    from fem_snh.terms.loads import Pressure


class FollowerPressure(UFLTerms):
    r"""Forces per deformed area, normal to the deformed surface.

    .. math:: R(u; v) = \sum_i a_i(\lambda)\, p_i \int_{\Gamma_i} \mathrm{cof}(F) N \cdot v
        \, \mathrm{d}A

    Surfaces with equal pressures are examined together, as a closed surface may consist of several
    groups. If any pressure is not conservative, the exact Hessian is not symmetric.

    Parameters
    ----------
    pressures : sequence of Pressure
        The pressures p_i [Pa] on the surfaces Gamma_i.
    body : Body
        The body that they act on.

    Attributes
    ----------
    has_energy : bool
        Whether all pressures are conservative: see `fem_snh.terms.swept_volume`.
    note : str
        A sentence on the pressures that are not conservative; empty without any.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or not a surface.
    """

    def __init__(self, pressures: Sequence[Pressure], body: Body) -> None:
        super().__init__("pressure", body.u)
        V, kinematics = body.V, body.kinematics
        amplitudes = [body.amplitudes.force(load.table) for load in pressures]
        facets = [body.facets("pressure.group", load.group) for load in pressures]
        self._values: list[Any] = []
        for load, amplitude, on in zip(pressures, amplitudes, facets, strict=True):
            p = load.value if is_expression(load.value) else body.constant(load.value)
            check_expression("pressure.value", p, body.u)
            self._values.append(p)
            self.add(SweptVolume(V, on, kinematics).residual(body.u, p), amplitude)
        #: For each set of equal pressures, the number of its first one, and the swept volume.
        self._enclosed: list[tuple[int, SweptVolume]] = []
        equal = [(a, load.value) for a, load in zip(amplitudes, pressures, strict=True)]
        causes: dict[str, list[str]] = {}
        for pressure in dict.fromkeys(equal):
            which = [i for i, other in enumerate(equal) if other == pressure]
            on, cause = np.unique(np.concatenate([facets[i] for i in which])), ""
            if not is_uniform(pressure[1]):
                cause = "as it varies over the surface"
            else:
                try:
                    closing = ClosingSurface(V, on, body.dirichlet, kinematics)
                    volume = SweptVolume(V, on, kinematics, closing)
                    self._enclosed.append((which[0], volume))
                    if closing.lids:
                        cause = "as it ends on a rigid part, on which it does not act"
                except NotClosedError:
                    cause = "as an edge of the surface is free"
            names = [f"'{surface_name(pressures[i].group)}'" for i in which]
            causes.setdefault(cause, []).extend(names)
        causes.pop("", None)
        self.has_energy = self.symmetric = not causes
        texts = [
            f"the pressure on {', '.join(on)} has no energy, {why}" for why, on in causes.items()
        ]
        self.note = f"{'; '.join(texts)}: the line search is on the residual" if texts else ""

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the potential energy of the pressures [J], zero at u = 0. Collective.

        Raises
        ------
        BadInput
            If the pressures are not conservative.
        """
        if not self.has_energy:
            raise BadInput(self.note)
        return sum(
            float(self._factors[i][0].value * present(self._values[i])) * volume.change(u)
            for i, volume in self._enclosed
        )
