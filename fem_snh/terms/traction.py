"""Dead loads on physical groups of surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.errors import bad_value
from fem_snh.mesh.mesh import Mesh
from fem_snh.terms.dead_load import Amplitude, DeadLoad


class SurfaceLoad(Protocol):
    """A force per reference area on a physical group."""

    @property
    def group(self) -> str | int:
        """Name or number of the physical group."""

    @property
    def vector(self) -> Sequence[float]:
        """The (3,) force per reference area [Pa]."""


class Traction(DeadLoad):
    r"""Forces per reference area, of constant direction.

    .. math:: E = -\sum_i a_i(\lambda) \int_{\Gamma_i} t_i \cdot u \, \mathrm{d}A

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh
        The mesh whose physical groups the loads name.
    loads : sequence of SurfaceLoad
        The tractions t_i [Pa] on the surfaces Gamma_i.
    amplitudes : sequence of callables, optional
        The factors a_i as functions of the load; without, the load itself.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or not a surface.
    """

    def __init__(
        self,
        V: Any,
        mesh: Mesh,
        loads: Sequence[SurfaceLoad],
        amplitudes: Sequence[Amplitude] | None = None,
    ) -> None:
        super().__init__("traction", V)
        test = ufl.TestFunction(V)
        for load, amplitude in zip(loads, amplitudes or [float] * len(loads), strict=True):
            ds = surface_measure(mesh, "traction", load.group)
            # One form per load: UFL accepts one set of marked facets per form.
            self.add(ufl.inner(_dolfinx.constant(mesh.domain, load.vector), test) * ds, amplitude)
        self.set_load(0.0)


def surface_measure(mesh: Mesh, table: str, key: str | int) -> Any:
    """Return the UFL measure of a physical group that the scene's ``table`` names.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or not a surface.
    """
    return _dolfinx.surface_measure(mesh.domain, surface_facets(mesh, f"{table}.group", key))


def surface_facets(mesh: Mesh, where: str, key: str | int) -> npt.NDArray[Any]:
    """Return this rank's facets of a physical group that the scene's key ``where`` names, (n,).

    Collective.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown, not a surface, or in part inside of the body:
        an integral over the boundary would leave that part out.
    """
    group = mesh.group(key)
    if group.dim != 2:
        raise bad_value(where, key, f"a surface, not a {group.label}")
    exterior = _dolfinx.exterior_facets(mesh.domain)[0]
    outside = mesh.domain.comm.allreduce(int(np.isin(exterior, group.entities).sum()))
    if outside < group.count:
        inside = group.count - outside
        accepted = f"a surface of the body; {inside} of its {group.count} facets are inside of it"
        raise bad_value(where, key, accepted)
    return group.entities
