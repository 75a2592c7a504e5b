"""Contact between the surfaces of two bodies of one mesh, without friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.choices import FILTERS
from fem_snh.contact.gathered_surface import GatheredSurface
from fem_snh.contact.law import cell_heights, default_stiffness, surface_mean
from fem_snh.contact.surface_contact import SurfaceContact
from fem_snh.contact.surface_pair import BodyPair, SurfacePair
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.errors import bad_value, choose
from fem_snh.terms.history import MeanForceTerm
from fem_snh.terms.term import CouplingTerm

Array = npt.NDArray[Any]

#: Degree of the quadrature beyond that of products of shape functions: those of the other surface
#: have kinks inside of a facet. It reduces the error of a uniform pressure to a third.
_QUADRATURE = 4
#: Of `CouplingTerm`. With 100 times the stiffness the largest component of a force is within 3.2 %
#: of what the estimate finds of the penalty, an energy within 6.3 %: blocks and a ball on a block.
_UNSETTLED_PENALTY = 0.1


class BodyContact(SurfaceContact, MeanForceTerm, CouplingTerm):
    r"""The energy of contact between pairs of surfaces. Collective.

    The quadrature points of either surface have gaps to the other one, with half of the stiffness
    each, so that the result does not depend on the order of the surfaces:

    .. math:: E = \sum_{s = 1}^{2} \sum_{q \in \Gamma_s} \frac{w_q}{k}
        \left(\langle \ell_q - \tfrac{k}{2} g_q \rangle^2 - \ell_q^2\right)

    During a solve each point has one facet of the other surface, the closest one at the start of
    the step. After a solve the search is repeated, and the step is solved again until the forces
    have settled. `fem_snh.contact.gaps` has the derivatives of the gap.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    regions : sequence of Region
        The materials, which the default stiffness depends on.
    pairs : sequence of BodyPair
        The surfaces.
    kinematics : Kinematics, optional
        That of the displacement.

    Attributes
    ----------
    surface : GatheredSurface
        The nodes of all surfaces, on every rank.
    pairs : list of SurfacePair
        The contact of each pair.

    Raises
    ------
    BadInput
        On every rank, if a surface has no facet on the boundary, or the two have a common node.
    """

    name = "contact"
    pairs: list[SurfacePair]
    unsettled_penalty = _UNSETTLED_PENALTY

    def __init__(
        self,
        V: Any,
        regions: Sequence[Region],
        pairs: Sequence[BodyPair],
        kinematics: Kinematics = SOLID,
    ) -> None:
        super().__init__(V, kinematics)
        comm, degree = V.mesh.comm, _QUADRATURE + 2 * _dolfinx.degree(V)
        surfaces = list[SurfaceQuadrature]()
        for pair in pairs:
            for facets in (pair.first, pair.second):
                surfaces.append(SurfaceQuadrature(V, facets, degree, kinematics.revolved))
                if not comm.allreduce(len(surfaces[-1])):
                    raise bad_value("contact.groups", pair.name, "two surfaces of the boundary")
        self.surface = GatheredSurface(V, surfaces)
        self.pairs = []
        for i, pair in enumerate(pairs):
            both, sides = surfaces[2 * i : 2 * i + 2], self.surface.sides[2 * i : 2 * i + 2]
            default = min(surface_mean(s, default_stiffness(s, V, regions), comm) for s in both)
            height = max(surface_mean(s, cell_heights(s, V), comm) for s in both)
            first, second = sides
            self.pairs.append(SurfacePair(pair, self.surface, (first, second), default, height))
        self._passes = [one for pair in self.pairs for one in pair.passes]
        self._stale, self._stepped = True, False
        self._coupled: tuple[list[Array], Array] | None = None

    def set_load(self, load: float) -> None:
        """Search again at the next evaluation, if nothing calls `begin_step`."""
        self._stale |= not self._stepped

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        x = self.configuration(u)
        parts = [one.pairs(x) for one in self._passes]
        if self._coupled is None or any(map(lambda a, b: a is not b, parts, self._coupled[0])):
            self._coupled = parts, np.concatenate(parts)
        return self._coupled[1]

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the filtered Hessian; return how many points were filtered. Collective."""
        choose("filter", filter, FILTERS)
        x, count = self.configuration(u), 0
        for pair in self.pairs:
            for nodes, matrices, filtered in pair.matrices(x, filter):
                target.add_couplings(nodes, matrices)
                count += filtered
        return count

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset the multipliers to those of the last step and search the facets. Collective."""
        self._stepped, self._stale = True, True
        super().begin_step(u)

    def history(self) -> tuple[Array, Array]:
        """Return points of this rank's facets (n, 3), and what is kept there, (n, 2)."""
        found = [pair.history() for pair in self.pairs if pair.law.augmented]
        points = [np.empty((0, 3)), *(points for points, _ in found)]
        values = [np.empty((0, 2)), *(values for _, values in found)]
        return np.concatenate(points), np.concatenate(values)

    def set_history(self, values: Array) -> None:
        """Set what is kept, in the order of `history`. Collective."""
        first = 0
        for pair in self.pairs:
            if pair.law.augmented:
                last = first + len(pair.own_rows)
                pair.set_history(values[first:last])
                first = last

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return the positions of the nodes; search the facets if nothing did. Collective."""
        x = self.surface.positions(super().configuration(u))
        if self._stale:
            self._stale = False
            for one in self._passes:
                one.search(x)
        return x

    def add_nodal(self, values: Array, vector: PETSc.Vec) -> None:
        """Add vectors at the nodes (m, c) to this rank's own entries of a vector."""
        self.surface.add_own(values, self._rows(vector))

    def _sum(self, values: Any) -> Any:
        """Return the values, as every rank has all points."""
        return values
