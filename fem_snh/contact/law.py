"""Contact's law: penalty and augmented Lagrangian, their default stiffness and tolerance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.regions import Region
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.mesh.mesh import cell_volumes
from fem_snh.terms.settling import LaggedChange, largest_change, relative

Array = npt.NDArray[Any]

#: Default tolerance of the gap in the height of the cell at the surface.
TOLERANCE = 1e-3
#: With the default tolerance the sum of the pressures' changes by an augmentation, k ``|g|``, is
#: below this part of the force, too: a small load leaves a small gap, without any augmentation.
#: What the force then lacks is smaller by E/(k h), which is a tenth or less.
FORCE_TOLERANCE = 0.02
#: Below this part of the tolerance of the gap forces are not looked at: with the default stiffness
#: pressures of 1e-5 E, as of surfaces that just part, may be noise of Newton's method.
_UNSEEN = 1e-3
#: Augmentations that leave more than this part of the gap increase the stiffness by this factor
#: (Nocedal & Wright 2006, framework 17.3), at most to this multiple of the default stiffness.
#: Multipliers at more points than a facet can follow need it: without, a ball of 3 cells that
#: bounces stops after 50 augmentations, with it a step takes about 20 Newton iterations.
_SLOW, _GROWTH, _LARGEST = 0.25, 4.0, 1e4
#: Penalty stiffness in E over the size of the cell at the facet: where the contact pressure is E/10
#: the penetration is a hundredth of the cell.
#: ``python -m benchmarks hertz --factors 0.1,1,10,100`` measures what it leaves and what it costs.
FACTOR = 10.0
#: Height of a cell over a facet, in its volume over the facet's area.
_HEIGHT = {"tetrahedron": 3.0, "hexahedron": 1.0, "triangle": 2.0, "quadrilateral": 1.0}


class ContactLaw:
    r"""Normal contact of points, with a penalty or with an augmented Lagrangian.

    With the gap g of the points, their weights w_q, the stiffness k and multipliers :math:`\ell`,
    which are zero with a penalty (Wriggers 2006, section 6.3):

    .. math:: E = \sum_q \frac{w_q}{2 k} \left(p^2 - \ell^2\right), \qquad
        p = \langle \ell - k g \rangle = \max(\ell - k g, 0)

    An augmentation sets the multipliers to the pressures. The stiffness increases in a step while
    they reduce the gap slowly. The next step begins with the given stiffness, or with the increased
    one where that is below the default: with a far smaller one the multipliers are a dead load,
    under which a compressed body may have no stable equilibrium.

    ``rows`` number points along the first axis of the weights; gaps [m] and pressures [Pa] have the
    shape of the weights' rows.

    Parameters
    ----------
    name : str
        Of the contact, for the reason of a failure.
    weights : array
        Quadrature weights in the reference configuration [m^2].
    stiffness : array
        Penalty stiffness k [Pa/m], of a shape that extends to that of the weights.
    ratio : float
        The default stiffness over the given one.
    augmented : bool
        Whether there are multipliers.
    tolerance : array or float
        Largest gap in contact [m], with multipliers.
    limits_force : bool
        Whether the change of the force by an augmentation is limited, too.
    comm : MPI.Comm
        The ranks that share the points. Default: each rank has all of them.

    Attributes
    ----------
    multipliers : array
        The multipliers l [Pa].
    stiffness : array
        The present stiffness [Pa/m].
    kept, kept_factor : array, float
        The multipliers and the factor of the given stiffness at the start of a step.
    version : int
        Changes whenever multipliers or stiffness do.
    """

    def __init__(
        self,
        name: str,
        weights: Array,
        stiffness: Array,
        ratio: float = 1.0,
        augmented: bool = False,
        tolerance: Array | float = 0.0,
        limits_force: bool = False,
        comm: MPI.Comm = MPI.COMM_SELF,
    ) -> None:
        self.weights, self.augmented = weights, augmented
        self._name, self._comm, self._limits_force = name, comm, limits_force
        self._tolerance = np.broadcast_to(tolerance, weights.shape)
        self._given = np.broadcast_to(stiffness, weights.shape)
        self.multipliers, self.kept = np.zeros_like(weights), np.zeros_like(weights)
        self._default, self._largest = max(ratio, 1.0), max(_LARGEST * ratio, 1.0)
        self.kept_factor, self.version = 1.0, 0
        self.begin_step()

    def begin_step(self) -> None:
        """Reset the multipliers and the stiffness to those of the last accepted step."""
        self._gap = math.inf
        self._set(self.kept_factor, slice(None), self.kept)

    def end_step(self, rows: Array, gap: Array, pressure: Array) -> None:
        """Keep the multipliers; they take over the pressure that an increased stiffness has had."""
        factor = min(self._factor, self._default)
        if factor < self._factor:
            taken = np.where(pressure > 0, pressure + factor * self._given[rows] * gap, 0.0)
            self._set(factor, rows, taken)
        self.kept[:], self.kept_factor = self.multipliers, factor

    def scale_penalty(self, factor: float) -> bool:
        """Multiply the given stiffness; return whether it is a penalty's, without multipliers."""
        if self.augmented:
            return False
        self._given = factor * self._given
        self._set(self._factor, slice(None), self.kept)
        return True

    def trial(self, rows: Array, gap: Array) -> Array:
        """Return l - k g, whose positive part is the pressure."""
        return np.asarray(self.multipliers[rows] - self.stiffness[rows] * gap)

    def energy(self, rows: Array, pressure: Array) -> float:
        """Return the energy of all points, of which these have a pressure [J]."""
        acting = (self.weights[rows] * pressure**2 / self.stiffness[rows]).sum()
        if not self.augmented:
            return 0.5 * float(acting)
        kept = (self.weights * self.multipliers**2 / self.stiffness).sum()
        return 0.5 * float(acting - kept)

    def settle(self, rows: Array, gap: Array, pressure: Array) -> list[LaggedChange]:
        """Return the gap and the change of the force; augment if one is too large. Collective.

        With a penalty there are none.
        """
        if not self.augmented:
            return []
        found = (np.abs(gap) / self._tolerance[rows])[pressure > 0]
        error = self._comm.allreduce(float(found.max(initial=0.0)), op=MPI.MAX)
        changes = [LaggedChange(error, f"{self._name}: the gap")]
        if self._limits_force:
            change = self.multipliers.copy()
            change[rows] -= pressure
            sums = (self.weights * np.abs(change)).sum(), (self.weights[rows] * pressure).sum()
            lost, force = self._comm.allreduce(np.array(sums)).tolist()
            ratio = relative(lost, force, FORCE_TOLERANCE)
            what = f"{self._name}: the change of multipliers"
            changes.append(LaggedChange(min(ratio, error / _UNSEEN), what))
        if not largest_change(changes).settled:
            slow = error > _SLOW * self._gap and self._factor < self._largest
            self._set(self._factor * (_GROWTH if slow else 1.0), rows, pressure)
            self._gap = error
        return changes

    def history(self) -> tuple[Array, Array]:
        """Return columns (n, 1) of what is kept at the points: multipliers, and the factor."""
        column = self.kept.reshape(-1, 1)
        return column, np.full_like(column, self.kept_factor)

    def _set(self, factor: float, rows: Array | slice, multipliers: Array) -> None:
        """Set the factor of the stiffness, and the multipliers: those of other rows are zero."""
        self._factor, self.stiffness = factor, factor * self._given
        values = np.zeros_like(self.multipliers)
        values[rows] = multipliers
        self.multipliers[:] = values
        self.version += 1


def cell_heights(surface: SurfaceQuadrature, V: Any) -> Array:
    """Return the height of the cell over each facet [m], (facets,)."""
    factor = _HEIGHT[_dolfinx.cell_name(V.mesh)]
    return np.asarray(factor * cell_volumes(V.mesh)[surface.cells] / surface.areas)


def surface_mean(surface: SurfaceQuadrature, values: Array, comm: MPI.Comm) -> float:
    """Return the mean over the area of values of the facets. Collective."""
    areas = surface.weights.sum(axis=1)
    total = comm.allreduce(np.array([areas @ values, areas.sum()]))
    return float(total[0] / total[1])


def cell_moduli(V: Any, regions: Sequence[Region]) -> Array:
    """Return Young's modulus in each owned cell [Pa]."""
    moduli = np.empty(_dolfinx.num_owned(V.mesh))
    for region in regions:
        moduli[region.cells] = region.material.numbers.E
    return moduli


def default_stiffness(surface: SurfaceQuadrature, V: Any, regions: Sequence[Region]) -> Array:
    """Return the default penalty stiffness of each facet [Pa/m], (facets,)."""
    return np.asarray(FACTOR * cell_moduli(V, regions)[surface.cells] / cell_heights(surface, V))
