"""Contact between the surfaces of two bodies of one mesh, without friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.ghosted_vectors import local_values, writable_values
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.choices import FILTERS
from fem_snh.contact.gathered_surface import GatheredSurface
from fem_snh.contact.law import TOLERANCE, cell_heights, default_stiffness, surface_mean
from fem_snh.contact.surface_pair import BodyPair, SurfacePair
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.errors import bad_value, choose
from fem_snh.terms.history import HistoryTerm, MeanForceTerm
from fem_snh.terms.settling import LaggedChange, largest_change
from fem_snh.terms.term import CouplingTerm, ForceTerm

Array = npt.NDArray[Any]

#: Degree of the quadrature beyond that of products of shape functions: those of the other surface
#: have kinks inside of a facet. It reduces the error of a uniform pressure to a third.
_QUADRATURE = 4
#: Of `CouplingTerm`. With 100 times the stiffness the largest component of a force is within 3.2 %
#: of what the estimate finds of the penalty, an energy within 6.3 %: blocks and a ball on a block.
_UNSETTLED_PENALTY = 0.1


class BodyContact(HistoryTerm, MeanForceTerm, ForceTerm, CouplingTerm):
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

    name, has_penalties, is_contact = "contact", True, True
    unsettled_penalty = _UNSETTLED_PENALTY

    def __init__(
        self,
        V: Any,
        regions: Sequence[Region],
        pairs: Sequence[BodyPair],
        kinematics: Kinematics = SOLID,
    ) -> None:
        self._kinematics = kinematics
        comm, degree = V.mesh.comm, _QUADRATURE + 2 * _dolfinx.degree(V)
        surfaces = list[SurfaceQuadrature]()
        for pair in pairs:
            for facets in (pair.first, pair.second):
                surfaces.append(SurfaceQuadrature(V, facets, degree, kinematics.revolved))
                if not comm.allreduce(len(surfaces[-1])):
                    raise bad_value("contact.groups", pair.name, "two surfaces of the boundary")
        self.surface = GatheredSurface(V, surfaces)
        self.pairs = list[SurfacePair]()
        for i, pair in enumerate(pairs):
            both, sides = surfaces[2 * i : 2 * i + 2], self.surface.sides[2 * i : 2 * i + 2]
            default = min(surface_mean(s, default_stiffness(s, V, regions), comm) for s in both)
            height = max(surface_mean(s, cell_heights(s, V), comm) for s in both)
            first, second = sides
            self.pairs.append(
                SurfacePair(pair, self.surface, (first, second), default, TOLERANCE * height)
            )
        self._passes = [one for pair in self.pairs for one in pair.passes]
        self._stale, self._stepped = True, False
        self._coupled: tuple[list[Array], Array] | None = None

    def set_load(self, load: float) -> None:
        """Search again at the next evaluation, if nothing calls `begin_step`."""
        self._stale |= not self._stepped

    def weight_mean_forces(self, weight: float | None) -> None:
        """Set the weight of a step's mean forces: see `MeanForceTerm`."""
        for pair in self.pairs:
            pair.weight_mean_forces(weight)

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of penalties; return whether there are any."""
        return any([pair.law.scale_penalty(factor) for pair in self.pairs])

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of contact [J]. Collective."""
        x = self._positions(u)
        return sum(pair.energy(x) for pair in self.pairs)

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to this rank's own entries of ``r_u``. Collective."""
        x = self._positions(u)
        r = writable_values(r_u).reshape(-1, self._kinematics.components)
        for pair in self.pairs:
            self.surface.add_own(pair.gradient(x), r)

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        x = self._positions(u)
        parts = [one.pairs(x) for one in self._passes]
        if self._coupled is None or any(map(lambda a, b: a is not b, parts, self._coupled[0])):
            self._coupled = parts, np.concatenate(parts)
        return self._coupled[1]

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the filtered Hessian; return how many points were filtered. Collective."""
        choose("filter", filter, FILTERS)
        x, count = self._positions(u), 0
        for one in self._passes:
            nodes, matrices, filtered = one.matrices(x, filter)
            target.add_couplings(nodes, matrices)
            count += filtered
        return count

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, dict[str, Any]]]:
        """Return the rows of the pairs for run.json. Collective.

        ``force`` [N], which the second surface exerts on the first; ``contacts``, the number of
        points that touch; ``penetration`` [m], their largest; ``deepest`` and ``deepest_at`` of
        `DeepestPoint.row`; ``stiffness`` [Pa/m].
        """
        x = self._positions(u)
        return {"contacts": {pair.name: pair.row(x) for pair in self.pairs}}

    @property
    def goals(self) -> list[str]:
        """The names of the forces on first surfaces: see `Term.goals`."""
        return [f"{pair.name}.force" for pair in self.pairs]

    def goal(self, name: str, u: PETSc.Vec) -> Array:
        """Return a force on a first surface [N]: see `Term.goals`. Collective."""
        return self.pairs[self.goals.index(name)].force(self._positions(u))

    def add_nodal_forces(self, name: str, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the nodal forces of a force: see `fem_snh.terms.term.ForceTerm`. Collective."""
        forces = self.pairs[self.goals.index(name)].nodal_forces(self._positions(u))
        self.surface.add_own(forces, writable_values(r).reshape(-1, self._kinematics.components))

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative of a force to own entries: see `Term.goals`. Collective."""
        found = self.pairs[self.goals.index(name)].force_derivative(component, self._positions(u))
        self.surface.add_own(found, writable_values(g).reshape(-1, found.shape[1]))

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset the multipliers to those of the last step and search the facets. Collective."""
        self._stepped, self._stale = True, True
        for pair in self.pairs:
            pair.law.begin_step()
        x = self._positions(u)
        for pair in self.pairs:
            pair.begin_step(x)

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Search again, update multipliers; return the largest change. Collective."""
        x = self._positions(u)
        return largest_change([pair.settle(x) for pair in self.pairs])

    def end_step(self, u: PETSc.Vec) -> None:
        """Keep the multipliers."""
        x = self._positions(u)
        for pair in self.pairs:
            pair.end_step(x)

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

    def _positions(self, u: PETSc.Vec) -> Array:
        """Return the positions of the nodes; search the facets if nothing did. Collective."""
        x = self.surface.positions(self._kinematics.padded(local_values(u)))
        if self._stale:
            self._stale = False
            for one in self._passes:
                one.search(x)
        return x
