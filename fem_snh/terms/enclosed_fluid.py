"""Fluids of prescribed volume that surfaces enclose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.ghosted_vectors import (
    add_ghosts,
    local_values,
    set_to_zero,
    writable_values,
)
from fem_snh.errors import bad_value
from fem_snh.tables.types import surface_name
from fem_snh.terms.body import Body
from fem_snh.terms.swept_volume import SweptVolume, enclosed_volume, fit_fields
from fem_snh.terms.ufl_term import UFLTerm
from fem_snh.terms.values import is_uniform, present

if TYPE_CHECKING:
    from fem_snh.terms.cavity import Cavity

#: Default stiffness of a fluid, in E over the body's volume: a pressure of E then compresses it by
#: a hundredth of the body's volume. A stiffer fluid shortens Newton's steps, as the volume is
#: nonlinear in the displacement.
_STIFFNESS = 100.0
#: Loads at which the prescribed volume is examined.
_LOADS = 201


class EnclosedFluid:
    r"""A fluid in a cavity of the body, to which a prescribed volume is added.

    .. math:: E = \frac{k}{2} \left(a(\lambda) V^* - \Delta V(u)\right)^2, \qquad
        p = k \left(a(\lambda) V^* - \Delta V(u)\right)

    The cavity's change of volume :math:`\Delta V` is minus the volume that its surface sweeps, as
    the body's normal points into it. The state is one of equilibrium with the pressure p, for any
    stiffness k: the pairs of :math:`\Delta V` and p are points of the body's own curve, also where
    the pressure decreases with the volume and a prescribed pressure would be unstable.

    The Hessian is that of a follower pressure plus k g g^T, g the derivative of :math:`\Delta V`:
    a dense matrix of rank one, which `rank_one` returns as g.

    Parameters
    ----------
    fluid : Cavity
        The surface, the volume V*, its factor a and the stiffness k [Pa/m^3].
    body : Body
        What it acts on.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown, not a surface, or does not enclose a volume, and
        for a volume that empties the cavity.
    """

    name, has_energy, depends_on_load = "cavity", True, True

    def __init__(self, fluid: Cavity, body: Body) -> None:
        u, dirichlet = body.u, body.dirichlet
        if not is_uniform(fluid.volume):
            accepted = "a number, or an expression of Constants: one volume"
            raise bad_value("cavity.volume", fluid.volume, accepted)
        ds = body.surface("cavity.group", fluid.group)
        self.group, self._added, self._target = surface_name(fluid.group), fluid.volume, 0.0
        self._amplitude = body.amplitudes.motion(fluid.table)
        self._is_default = fluid.stiffness is None
        self._stiffness = fluid.stiffness or _STIFFNESS * body.modulus / body.volume
        self._pressure = body.constant(0.0)
        for parts in (None, dirichlet.rigid_parts):  # lids, where it is not closed without them
            self._volume = SweptVolume(body.V, ds, body.kinematics, parts)
            fields = fit_fields([self._volume], [1.0], dirichlet)
            # Planes of symmetry close a lid whose edge is not: f must be that of such planes.
            if fields is not None and (fields.any() or not self._volume.has_open_lids):
                break
        else:
            accepted = "a surface that encloses a volume: closed, or with an edge that is "
            accepted += "constrained, on rigid parts or in planes of symmetry"
            raise bad_value("cavity.group", self.group, accepted)
        self._volume.set_field(fields[0])
        self._term = UFLTerm(self._pressure * self._volume.residual(u), u, self.name)
        self._whole, self._lid_dofs = self._term, self._volume.lid_dofs
        if body.domain.comm.allreduce(len(self._lid_dofs)):
            self._whole = UFLTerm(self._pressure * self._volume.derivative(u), u, self.name)
        self._term.symmetric = self._whole.symmetric = True
        self._check_volume(fields[0], dirichlet)

    def _check_volume(self, parameters: npt.NDArray[Any], dirichlet: Dirichlet) -> None:
        """Raise BadInput if more fluid leaves the cavity than there is. Collective."""
        least = min(
            self._amplitude(load) * float(present(self._added))
            for load in np.linspace(0, 1, _LOADS)
        )
        if least >= 0 or self._whole is not self._term:  # S has no constant of a lid
            return
        swept = enclosed_volume(self._volume, parameters, dirichlet)
        if swept is not None and least <= swept:  # the body's normals point into the cavity
            accepted = f"a volume that leaves some of the {-swept:.6g} m^3 in the cavity"
            raise bad_value("cavity.volume", float(present(self._added)), accepted)

    def set_load(self, load: float) -> None:
        """Set the volume of a load."""
        self._target = self._amplitude(load) * float(present(self._added))

    def scale_penalties(self, factor: float) -> bool:
        """Multiply a default stiffness; a given one is a property of the fluid: return False."""
        if self._is_default:
            self._stiffness *= factor
        return self._is_default

    def state(self, u: PETSc.Vec) -> dict[str, float]:
        """Return the cavity's added "volume" [m^3] and the fluid's "pressure" [Pa]. Collective."""
        volume = -self._volume.change(u)
        return {"volume": volume, "pressure": self._stiffness * (self._target - volume)}

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, dict[str, float]]]:
        """Return the cavity's `state` for run.json. Collective."""
        return {"cavities": {self.group: self.state(u)}}

    @property
    def goals(self) -> list[str]:
        """The name of the fluid's pressure: see `GoalTerm`."""
        return [f"{self.group}.pressure"]

    def goal(self, name: str, u: PETSc.Vec) -> npt.NDArray[Any]:
        """Return the pressure [Pa]: see `GoalTerm`. Collective."""
        return np.array([self.state(u)["pressure"]])

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add that of the pressure: see `GoalTerm`."""
        self._pressure.value = np.array(self._stiffness)  # -k times the change of volume
        self._add_forces(u, g)

    def _add_forces(self, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the forces of the present pressure, on lids those of the whole volume. Collective."""
        if self._whole is self._term:
            return self._term.add_residual(u, None, r, None)
        forces, on_lids = _dolfinx.create_vector(self._volume.V), self._lid_dofs
        self._whole.add_residual(u, None, forces, None)
        kept = local_values(forces)[on_lids]
        set_to_zero(forces)
        self._term.add_residual(u, None, forces, None)
        writable_values(forces)[on_lids] = kept
        writable_values(r)[:] += local_values(forces)

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of the fluid [J]. Collective."""
        pressure = self.state(u)["pressure"]
        return pressure * pressure / (2 * self._stiffness)  # a power raises OverflowError

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to all entries of ``r_u``, ghosts included. Collective."""
        self._pressure.value = np.array(self.state(u)["pressure"])
        self._add_forces(u, r_u)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the pressure's Hessian; return how many facets of this rank were filtered."""
        self._pressure.value = np.array(self.state(u)["pressure"])
        return self._whole.add_hessian(u, p, filter, target)

    def rank_one(self, u: PETSc.Vec, g: PETSc.Vec) -> float:
        """Set ``g``, ghosted, to the derivative of the volume; return k. Collective.

        The Hessian has the further part k g g^T.
        """
        set_to_zero(g)
        self._pressure.value = np.array(1.0)
        self._add_forces(u, g)
        add_ghosts(g)
        return self._stiffness
