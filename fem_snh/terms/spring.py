"""Elastic foundations: forces on surfaces, opposite to the displacement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.mesh.mesh import Mesh
from fem_snh.terms.dead_load import Amplitude
from fem_snh.terms.traction import surface_measure
from fem_snh.terms.ufl_term import UFLTerm
from fem_snh.terms.ufl_terms import UFLTerms


class Foundation(Protocol):
    """The stiffness of a foundation on a physical group."""

    @property
    def group(self) -> str | int:
        """Name or number of the physical group."""

    @property
    def stiffness(self) -> float | Sequence[float]:
        """Force per reference area and displacement [Pa/m], of all components or of each."""


class Spring(UFLTerms):
    r"""Foundations that resist the displacement of surfaces (Robin conditions).

    .. math:: E = \sum_i \frac{a_i(\lambda)}{2} \int_{\Gamma_i} k_i u \cdot u \, \mathrm{d}A

    Parameters
    ----------
    u : dolfinx Function
        The displacement.
    mesh : Mesh
        The mesh whose physical groups the foundations name.
    foundations : sequence of Foundation
        The stiffnesses k_i [Pa/m] on the surfaces Gamma_i.
    amplitudes : sequence of callables or None
        The factors a_i >= 0 as functions of the load; None for 1.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or not a surface.
    """

    name, has_energy = "spring", True

    def __init__(
        self,
        u: Any,
        mesh: Mesh,
        foundations: Sequence[Foundation],
        amplitudes: Sequence[Amplitude | None],
    ) -> None:
        self.depends_on_load = any(amplitude is not None for amplitude in amplitudes)
        self._amplitudes = list(amplitudes)
        self._given: list[npt.NDArray[Any]] = []
        self._present, self._terms = [], []
        for foundation in foundations:
            self._given.append(np.broadcast_to(np.array(foundation.stiffness, float), 3).copy())
            k = _dolfinx.constant(mesh.domain, self._given[-1])
            forces = ufl.as_vector([k[i] * u[i] for i in range(3)])
            ds = surface_measure(mesh, self.name, foundation.group)
            self._present.append(k)
            self._terms.append(UFLTerm(ufl.inner(forces, u) / 2 * ds, u, self.name))

    def set_load(self, load: float) -> None:
        """Set the stiffnesses of a load."""
        for k, given, amplitude in zip(self._present, self._given, self._amplitudes, strict=True):
            k.value[:] = given if amplitude is None else amplitude(load) * given

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of the foundations [J]. Collective."""
        return sum(term.energy(u, p) for term in self._terms)
