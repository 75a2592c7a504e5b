"""Contact's law: penalty and augmented Lagrangian, their default stiffness and tolerance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.regions import Region
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.mesh.mesh import cell_volumes
from fem_snh.terms.settling import relative

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


def multiplier_change(change: float, force: float, gap: float) -> float:
    """Return the change of multipliers in its tolerance.

    Parameters
    ----------
    change, force : float
        Sum of the pressures' changes by an augmentation, and of the pressures [N].
    gap : float
        The largest gap of points in contact, in its tolerance.
    """
    return min(relative(change, force, FORCE_TOLERANCE), gap / _UNSEEN)


class PenaltyGrowth:
    """The factor of the stiffness, which increases in a step while the gap decreases slowly.

    The next step begins with the given stiffness, or with the increased one where that is below the
    default: with a far smaller one the multipliers are a dead load, under which a compressed body
    may have no stable equilibrium.

    Parameters
    ----------
    ratio : float
        The default stiffness over the given one.

    Attributes
    ----------
    factor : float
        The present factor of the given stiffness.
    kept : float
        The factor at the start of a step.
    """

    def __init__(self, ratio: float = 1.0) -> None:
        self._default = max(ratio, 1.0)
        self._largest = max(_LARGEST * ratio, 1.0)
        self.kept = 1.0
        self.reset()

    def reset(self) -> None:
        """Begin a step."""
        self.factor, self._gap = self.kept, math.inf

    def update(self, gap: float) -> float:
        """Return the factor after an augmentation that has left this gap, in any unit."""
        if gap > _SLOW * self._gap and self.factor < self._largest:
            self.factor *= _GROWTH
        self._gap = gap
        return self.factor

    def keep(self) -> bool:
        """End a step; return whether the stiffness decreases to that of the next one."""
        self.kept = min(self.factor, self._default)
        decreases = self.factor > self.kept
        self.reset()
        return decreases


#: Penalty stiffness in E over the size of the cell at the facet: where the contact pressure is E/10
#: the penetration is a hundredth of the cell.
#: ``python -m benchmarks hertz --factors 0.1,1,10,100`` measures what it leaves and what it costs.
FACTOR = 10.0
#: Height of a cell over a facet, in its volume over the facet's area.
_HEIGHT = {"tetrahedron": 3.0, "hexahedron": 1.0}


def cell_heights(surface: SurfaceQuadrature, V: Any) -> Array:
    """Return the height of the cell over each facet [m], (facets,)."""
    areas = surface.weights.sum(axis=1)
    factor = _HEIGHT[_dolfinx.cell_name(V.mesh)]
    return np.asarray(factor * cell_volumes(V.mesh)[surface.cells] / areas)


def surface_mean(surface: SurfaceQuadrature, values: Array, comm: Any) -> float:
    """Return the mean over the area of values of the facets. Collective."""
    areas = surface.weights.sum(axis=1)
    total = comm.allreduce(np.array([areas @ values, areas.sum()]))
    return float(total[0] / total[1])


def default_stiffness(surface: SurfaceQuadrature, V: Any, regions: Sequence[Region]) -> Array:
    """Return the default penalty stiffness of each facet [Pa/m], (facets,)."""
    moduli = np.empty(_dolfinx.num_owned(V.mesh))
    for region in regions:
        moduli[region.cells] = region.material.numbers.E
    return np.asarray(FACTOR * moduli[surface.cells] / cell_heights(surface, V))
