"""Two surfaces that may touch, with the points of either one against the facets of the other."""

from __future__ import annotations

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.contact.deepest_point import DeepestPoint
from fem_snh.contact.gathered_surface import GatheredSurface, Side
from fem_snh.contact.law import PenaltyGrowth, multiplier_change
from fem_snh.contact.surface_pass import SurfacePass
from fem_snh.errors import bad_value
from fem_snh.terms.settling import LaggedChange, largest_change, relative

Array = npt.NDArray[Any]

#: Each point has settled on a facet when a new search changes no nodal force by more than this
#: fraction of the largest.
_SETTLED = 1e-4
#: After this many searches of a step a point keeps a facet whose closest point is outside of it by
#: less than _KEPT, in reference coordinates: a point at an edge between two facets of different
#: normals would change from one to the other and back for ever.
_FREE_SEARCHES, _KEPT = 3, 0.1
#: Reach of the search in the diagonal of the smaller surface: bodies may move by this in a step.
_REACH = 0.5
#: Points by which a checkpoint finds multipliers are inside of their body by this many facets, as
#: surfaces that touch have points at the same place.
_INSIDE = 1e-3


class BodyPair(NamedTuple):
    """Two surfaces of the mesh that may touch.

    Attributes
    ----------
    name : str
        Name in run.json.
    first, second : (n,) int
        This rank's facets of each surface.
    stiffness : float or None
        Penalty stiffness [Pa/m]; None for the smaller one of the surfaces' mean defaults.
    augmented : bool
        Whether multipliers reduce the penetration below the tolerance.
    tolerance : float or None
        Largest penetration [m] with the augmented Lagrangian; None for the default.
    limits_force : bool
        With the default tolerance, whether the change of the force is limited, too. In time it need
        not be: what a step's force lacks, the next one has.
    """

    name: str
    first: Array
    second: Array
    stiffness: float | None = None
    augmented: bool = False
    tolerance: float | None = None
    limits_force: bool = True


class SurfacePair:
    """Contact of two surfaces in two passes, each with half of the stiffness.

    All ranks have the same, and positions of the nodes ``x`` are (m, 3) [m].

    Parameters
    ----------
    pair : BodyPair
        Name and method.
    surface : GatheredSurface
        The nodes.
    first, second : Side
        The surfaces.
    stiffness : float
        Penalty stiffness [Pa/m].
    tolerance : float
        Largest penetration [m] with the augmented Lagrangian.
    ratio : float
        The default stiffness over the given one: see `PenaltyGrowth`.

    Attributes
    ----------
    passes : tuple of two SurfacePass
        The points of the first surface, and those of the second.

    Raises
    ------
    BadInput
        If a surface has no facet on the boundary, or the two have a common node.
    """

    def __init__(
        self,
        pair: BodyPair,
        surface: GatheredSurface,
        first: Side,
        second: Side,
        stiffness: float,
        tolerance: float,
        ratio: float = 1.0,
    ) -> None:
        if len(np.intersect1d(first.nodes, second.nodes)):
            raise bad_value("contact.groups", pair.name, "two surfaces without a common node")
        self.name, self.augmented = pair.name, pair.augmented
        self._limits_force = pair.tolerance is None and pair.limits_force
        self.stiffness, self._tolerance, self._surface = stiffness, tolerance, surface
        boxes = (np.ptp(surface.X[side.nodes.ravel()], axis=0) for side in (first, second))
        reach = _REACH * min(float(np.linalg.norm(box)) for box in boxes)
        self.passes = (
            SurfacePass(surface, first, second, stiffness / 2, reach),
            SurfacePass(surface, second, first, stiffness / 2, reach),
        )
        self._kept = [one.multipliers.copy() for one in self.passes]
        self._growth = PenaltyGrowth(ratio)

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the nodes [N], (m, 3)."""
        first, second = self.passes
        return first.gradient(x) + second.gradient(x)

    def row(self, x: Array) -> dict[str, Any]:
        """Return the pair's row of run.json: see `BodyContact.record`."""
        first = np.unique(self.passes[0].own.nodes)
        found = [one.touching(x) for one in self.passes]
        penetration = max(0.0, *(float(-at.gaps.gap.min(initial=0.0)) for at in found))
        deepest = DeepestPoint.deepest(one.deepest(x) for one in self.passes)
        return {
            "force": (-self.gradient(x)[first].sum(axis=0)).tolist(),
            "contacts": sum(int((at.pressure > 0).sum()) for at in found),
            "penetration": penetration,
            **deepest.row(penetration),
            "stiffness": self.stiffness,
        }

    def settle(self, x: Array, solves: int) -> LaggedChange:
        """Search again and update the multipliers; return the largest change.

        ``solves`` counts the solves of the step.
        """
        before = self.gradient(x)
        for one in self.passes:
            one.search(x, _KEPT if solves > _FREE_SEARCHES else None)
        after = self.gradient(x)
        largest = max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0))
        change = float(np.abs(after - before).max(initial=0.0))
        ratio = relative(change, largest, _SETTLED)
        what = f"contact '{self.name}': the change of forces by another search"
        changed = LaggedChange(ratio, what)
        if not self.augmented:
            return changed
        gap = max(one.largest_gap(x) for one in self.passes)
        error = gap / self._tolerance
        found = [LaggedChange(error, f"contact '{self.name}': the gap")]
        if self._limits_force:
            change, force = np.sum([one.augmentation(x) for one in self.passes], axis=0)
            what = f"contact '{self.name}': the change of multipliers"
            found.append(LaggedChange(multiplier_change(change, force, error), what))
        if not largest_change(found).settled:
            factor = self._growth.update(gap)
            for one in self.passes:
                one.set_multipliers(x)
                one.stiffness = factor * self.stiffness / 2
        return largest_change([changed, *found])

    def reset(self) -> None:
        """Reset the multipliers to those of the last step."""
        self._growth.reset()
        for one, kept in zip(self.passes, self._kept, strict=True):
            one.multipliers[:], one.stiffness = kept, self._growth.factor * self.stiffness / 2

    def keep(self, x: Array) -> None:
        """Keep the multipliers: the step is accepted."""
        decreases = self._growth.keep()
        for one, kept in zip(self.passes, self._kept, strict=True):
            if decreases:
                stiffness = self._growth.factor * self.stiffness / 2
                one.set_multipliers(x, stiffness)
                one.stiffness = stiffness
            kept[:] = one.multipliers

    def history(self) -> tuple[Array, Array]:
        """Return points of this rank's facets (n, 3), and multipliers and factors there, (n, 2)."""
        points, values = [], []
        for one, kept in zip(self.passes, self._kept, strict=True):
            X = self._surface.X
            inside = one.points(X) - _INSIDE * one.size * one.normals(X)
            points.append(inside[one.own_points])
            mine = kept[one.own_points]
            values.append(np.column_stack([mine, np.full(len(mine), self._growth.kept)]))
        return np.concatenate(points), np.concatenate(values)

    def set_history(self, values: Array) -> None:
        """Set what is kept, (n, 2), in the order of `history`. Collective."""
        first, comm = 0, self._surface.comm
        self._growth.kept = comm.allreduce(float(values[:, 1].max(initial=1.0)), op=MPI.MAX)
        for one, kept in zip(self.passes, self._kept, strict=True):
            last = first + len(one.own_points)
            mine = np.zeros_like(kept)
            mine[one.own_points] = values[first:last, 0]
            kept[:] = comm.allreduce(mine)  # each point has one owner
            first = last
