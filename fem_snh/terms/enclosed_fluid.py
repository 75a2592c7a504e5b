"""The energy of a fluid of prescribed volume that a surface encloses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from petsc4py import PETSc

import numpy as np

from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.unknowns import add_ghosts, set_to_zero
from fem_snh.errors import bad_value
from fem_snh.tables.types import surface_name
from fem_snh.terms.body import Body, is_uniform, present
from fem_snh.terms.closing_surface import ClosingSurface, NotClosedError
from fem_snh.terms.rank_one import RankOneTerm
from fem_snh.terms.swept_volume import SweptVolume
from fem_snh.terms.ufl_term import UFLTerm

if TYPE_CHECKING:
    from fem_snh.terms.cavity import Cavity

#: Default stiffness of a fluid, in E over the body's volume: a pressure of E then compresses it by
#: a hundredth of the body's volume. A stiffer fluid shortens Newton's steps, as the volume is
#: nonlinear in the displacement.
_STIFFNESS = 100.0
#: Number of equidistant loads in [0, 1] at which the prescribed volume is examined.
_LOADS = 201


class EnclosedFluid(RankOneTerm):
    r"""A fluid in a cavity of the body, to which a prescribed volume is added.

    .. math:: E = \frac{k}{2} \left(a(\lambda) V^* - \Delta V(u)\right)^2, \qquad
        p = k \left(a(\lambda) V^* - \Delta V(u)\right)

    The cavity's change of volume :math:`\Delta V` is minus the volume that its surface sweeps, as
    the body's normal points into the cavity. For any stiffness k the body is in equilibrium with
    the pressure p, so the pairs of :math:`\Delta V` and p are points of the body's
    pressure-volume curve, also where the pressure decreases with the volume and a prescribed
    pressure would be unstable.

    The Hessian is that of a follower pressure plus k g g^T, g the derivative of :math:`\Delta V`: a
    dense matrix of rank one, whose factors `rank_one` returns. The follower pressure is p at
    equilibrium; elsewhere it is the pressure that balances the body's forces best: `RankOneTerm`.

    Parameters
    ----------
    fluid : Cavity
        The surface, the volume V*, the table of its amplitude a and the stiffness k [Pa/m^3].
    body : Body
        The body around the cavity.

    Attributes
    ----------
    volume_at_rest : float or None
        The cavity's reference volume [m^3]; None if it is not known.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown, not a surface, or does not enclose a volume, and
        for a volume that empties the cavity.
    """

    name, has_energy, depends_on_load = "cavity", True, True
    stateless = has_penalties = True

    def __init__(self, fluid: Cavity, body: Body) -> None:
        u, dirichlet = body.u, body.dirichlet
        if not is_uniform(fluid.volume):
            accepted = "a number, or an expression of Constants: one volume"
            raise bad_value("cavity.volume", fluid.volume, accepted)
        facets = body.facets("cavity.group", fluid.group)
        self.group, self._added, self._target = surface_name(fluid.group), fluid.volume, 0.0
        self._amplitude = body.amplitudes.motion(fluid.table)
        self._is_default = fluid.stiffness is None
        self._stiffness = fluid.stiffness or _STIFFNESS * body.modulus / body.volume
        self._pressure = body.constant(0.0)
        try:
            closing = ClosingSurface(body.V, facets, dirichlet, body.kinematics)
            self._volume = SweptVolume(body.V, facets, body.kinematics, closing)
        except NotClosedError as error:
            accepted = "a surface that encloses a volume: closed, or with an edge that is "
            accepted += f"constrained, on rigid parts or in planes of symmetry; {error}"
            raise bad_value("cavity.group", self.group, accepted) from None
        # The body's normals point into the cavity.
        volume = self._volume.at_rest()
        self.volume_at_rest = None if volume is None else -volume
        self._term = UFLTerm(self._pressure * self._volume.residual(u), u, self.name)
        self._term.symmetric = True
        self._check_volume()

    def _check_volume(self) -> None:
        """Raise BadInput if the prescribed volume empties the cavity at any load. Collective."""
        least = min(
            self._amplitude(load) * float(present(self._added))
            for load in np.linspace(0, 1, _LOADS)
        )
        volume = self.volume_at_rest
        # The volume is negative for a fluid around the body.
        if volume is not None and volume > 0 and least <= -volume:
            accepted = f"a volume that leaves some of the {volume:.6g} m^3 in the cavity"
            raise bad_value("cavity.volume", float(present(self._added)), accepted)

    def set_load(self, load: float) -> None:
        """Set the prescribed volume a(load) V*."""
        self._target = self._amplitude(load) * float(present(self._added))

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness if it is the default, and return whether it is."""
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
        """The name of the fluid's pressure, "NAME.pressure": see `Term.goals`."""
        return [f"{self.group}.pressure"]

    def goal(self, name: str, u: PETSc.Vec) -> Array:
        """Return the fluid's pressure [Pa], (1,): see `Term.goal`. Collective."""
        return np.array([self.state(u)["pressure"]])

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative of the pressure by u: see `Term.add_goal_derivative`. Collective."""
        self._pressure.value = np.array(self._stiffness)  # -k times the change of volume
        self._term.add_residual(u, None, g, None)

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of the fluid [J]. Collective."""
        pressure = self.state(u)["pressure"]
        return pressure * pressure / (2 * self._stiffness)  # a power raises OverflowError

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the pressure's forces [N] to ``r_u``, ghosts included. Collective."""
        self._pressure.value = np.array(self.state(u)["pressure"])
        self._term.add_residual(u, p, r_u, r_p)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the Hessian of the follower pressure p + c, c the imbalance: see `Term.add_hessian`.

        `rank_one` gives the other part, k g g^T.
        """
        self._pressure.value = np.array(self.state(u)["pressure"] + self.imbalance)
        return self._term.add_hessian(u, p, filter, target)

    def rank_one(self, u: PETSc.Vec, g: PETSc.Vec) -> float:
        """Set ``g``, ghosted, to minus the derivative of Delta V; return k. Collective."""
        set_to_zero(g)
        self._pressure.value = np.array(1.0)
        self._term.add_residual(u, None, g, None)
        add_ghosts(g)
        return self._stiffness
