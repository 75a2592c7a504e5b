"""Self-contact by the map to the reference configuration (Smith et al. 2018, section 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.choices import FILTERS
from fem_snh.contact.reference_search import ContactPairs, TargetSearch
from fem_snh.contact.surface_contact import SelfContactTerm
from fem_snh.errors import choose
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.terms.settling import LaggedChange, relative

Array = npt.NDArray[Any]

#: The pairs have settled when a new search changes no nodal force by more than this fraction of the
#: largest one.
_SETTLED = 1e-2
#: After the first number of searches of a step a sample keeps a target that would move by less than
#: this part of a cell, after the second number any: where two triangles of different normals are
#: close, it would change from one to the other and back for ever.
_FREE_SEARCHES, _SEARCHES_TO_MOVE, _MOVED = 1, 2, 0.25


class ReferenceContact(SelfContactTerm):
    """The energy of contact of a body with itself, and of the bodies of a mesh. Collective.

    Samples of the surface, its corners among them, that are inside of deformed cells are mapped to
    the reference configuration by these cells. A spring pushes each out of the surface through its
    target, the closest point of the surface there, from which a local search looks for a closer one
    on the deformed surface. Samples that approach the surface have a target, too; sharp edges that
    cross have a spring between them. During a solve targets and normals are constant. After a solve
    the search is repeated, and the step is solved again until the forces have settled.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    skin : Skin or None
        The surface, if a lattice carries it; None for the boundary of the mesh.
    regions : sequence of Region
        The materials, which the default stiffness depends on.
    stiffness : float, optional
        Contact pressure over penetration [Pa/m]; default: 50 E over the size of the cells.
    kinematics : Kinematics, optional
        That of the displacement: of a solid, of a plane, or axisymmetric.

    Attributes
    ----------
    springs : ContactPairs
        The present pairs of samples and targets, the same on all ranks.
    """

    springs: ContactPairs
    _coupled: bool

    def __init__(
        self,
        V: Any,
        skin: Skin | None,
        regions: Sequence[Region],
        stiffness: float | None = None,
        kinematics: Kinematics = SOLID,
    ) -> None:
        super().__init__(V, skin, kinematics)
        revolved, overlap = kinematics.revolved, skin is not None
        self._search = TargetSearch(V, self.surface, regions, stiffness, overlap, revolved)
        self._set_springs(ContactPairs.none(len(self.surface.points), kinematics.components))
        self._searches, self._penetration, self._stale = 0, 0.0, True

    def set_load(self, load: float) -> None:
        """Search again at the next evaluation, that of the predicted displacement of a step."""
        self._stale = True

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of the springs; return True.

        Back from stiffer springs the state is another one: its pairs are searched for again.
        """
        self._search.scale_stiffness(factor)
        self._set_springs(replace(self.springs, stiffness=factor * self.springs.stiffness))
        self._stale |= factor < 1
        return True

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        self.configuration(u)
        if not self._coupled:
            self._coupled = True
            pattern = self._matrix.blocks(self.springs.pattern())
            if not self._matrix.contains(pattern):
                self._matrix.replace(pattern)
        return self._matrix.pairs

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the Hessian, which is positive semidefinite: nothing is filtered. Collective."""
        choose("filter", filter, FILTERS)
        x = self.configuration(u)
        self._matrix.add(self._matrix.blocks(self.springs.hessian(x)), target)
        return 0

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return the step's row for run.json. Collective.

        ``pairs``, how many springs push; ``penetration`` [m], that of the deepest point of the
        surface; ``force`` [N], the sum of the springs' forces, as lengths; ``stiffness`` [Pa/m],
        their mean.
        """
        x = self.configuration(u)
        row = {
            "pairs": int((self.springs.gaps(x) < 0).sum()),
            "penetration": self._penetration,
            "force": float(self.springs.forces(x).sum()),
            "stiffness": self._search.stiffness,
        }
        return {"self_contact": row}

    def begin_step(self, u: PETSc.Vec) -> None:
        """Search again at the next evaluation, that of the forces at the start of a time step.

        These depend on the displacement ``u`` alone, so that a run that is resumed has the same.
        """
        self._searches, self._stale = 0, True

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Search again; return the change of the forces. Collective."""
        x = self.configuration(u)
        before = self.surface.nodal(self.springs.gradient(x))
        self._searches += 1
        new = self._search.find(self._nodal(u), x)
        self._penetration = self._search.penetration(new, x)
        updated = self._updated(new, x)
        after = self.surface.nodal(updated.gradient(x))
        largest = max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0))
        ratio = relative(np.abs(after - before).max(initial=0.0), largest, _SETTLED)
        change = LaggedChange(ratio, "self_contact: the change of forces by another search")
        if not change.settled:  # else the pairs stay, with which the forces are in equilibrium
            self._set_springs(updated)
        return change

    def end_step(self, u: PETSc.Vec) -> None:
        """Do nothing: the next step searches again."""

    def history(self) -> tuple[Array, Array]:
        """Return no points and no values: the next step depends on the displacement alone."""
        return np.empty((0, 3)), np.empty((0, 1))

    def set_history(self, values: Array) -> None:
        """Do nothing, as there is no history."""

    def _updated(self, new: ContactPairs, x: Array) -> ContactPairs:
        """Return the pairs of a new search, with former ones."""
        old = self.springs
        if self._searches > _SEARCHES_TO_MOVE:
            return old.joined(new[~np.isin(new.sample, old.sample)])
        # A sample that its target has pushed out may come back in the next solve.
        kept = (old.gaps(x) >= 0) & ~np.isin(old.sample, new.sample)
        if self._searches > _FREE_SEARCHES:
            same = new.find(old, x, _MOVED * self._search.size)
            kept[same[same >= 0]] = True
            new = new[same < 0]
        return new.joined(old[kept])

    def _set_springs(self, springs: ContactPairs) -> None:
        self.springs, self.pairs = springs, [springs]
        self._coupled = False

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return the positions of the surface's points (n, dim) [m]; search if due. Collective."""
        x = super().configuration(u)
        if self._stale:
            self._stale = False
            self._set_springs(self._search.find(self._nodal(u), x))
        return x
