r"""Stable ranges of a fit along the three tests with free sides, by two criteria.

Drucker's criterion, as finite-element programs examine fits by it: Kirchhoff's stress
:math:`\tau_i = \partial\psi/\partial\varepsilon_i` increases with the logarithmic strains
:math:`\varepsilon_i = \log s_i`, :math:`d\tau : d\varepsilon > 0`, for all changes of the
principal stretches, which for an incompressible material keep the volume:

.. math::

    \sum_{ij} d\varepsilon_i \left(s_i \frac{\partial^2\psi}{\partial s_i \partial s_j} s_j
    + \delta_{ij} s_i \frac{\partial\psi}{\partial s_i}\right) d\varepsilon_j > 0

Stability under dead loads, :math:`dP : dF > 0` for the same changes, is stricter in tension: it is
lost where a force has a maximum, and where unequal stretches have the forces of equal ones
(Kearsley 1986), also of materials that Drucker's criterion finds stable at all stretches:

.. math::

    \sum_{ij} ds_i \left(\frac{\partial^2\psi}{\partial s_i \partial s_j}
    - p \frac{\partial^2 J}{\partial s_i \partial s_j}\right) ds_j > 0, \qquad
    p = s_2 \frac{\partial\psi}{\partial s_2}

The latter are the scaling eigenvalues of the material reports (`fem_snh.kernels.reports.curves`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fem_snh.studies.fit.responses import FREE, response, stretches

if TYPE_CHECKING:
    from fem_snh.studies.fit.family import Member

Array = npt.NDArray[np.float64]

#: Samples on each side of rest, and bisections of the ends of a stable range.
_SAMPLES, _BISECTIONS = 120, 30


@dataclass(frozen=True)
class StableRange:
    """The stretches around rest in which a material is stable in one test.

    Attributes
    ----------
    kind : str
        The test.
    low, high : float
        Ends of the stable range.
    searched : (float, float)
        The searched range; a stable range that ends there may extend further.
    """

    kind: str
    low: float
    high: float
    searched: tuple[float, float]

    @property
    def whole(self) -> bool:
        """Return whether all of the searched range is stable."""
        return (self.low, self.high) == self.searched


def stable_ranges(
    law: Member, low: float, high: float, dead_loads: bool = False
) -> tuple[StableRange, ...]:
    """Return the stable ranges of the uniaxial, the equibiaxial and the planar test.

    Parameters
    ----------
    law : Member
        The energy.
    low, high : float
        The range of stretches that is searched, around 1.
    dead_loads : bool
        Whether the criterion is stability under dead loads, not Drucker's.
    """
    return tuple(
        StableRange(
            kind, _end(law, kind, low, dead_loads), _end(law, kind, high, dead_loads), (low, high)
        )
        for kind in FREE
    )


def stable_at(law: Member, kind: str, x: Array, stretch_2: Array | None = None) -> bool:
    """Return whether a material is stable at the data of a test by Drucker's criterion.

    Those of a biaxial test are its points (n,), those of the others all from rest to the last one.
    """
    if kind == "biaxial":
        return bool((smallest_stiffness(law, kind, x, stretch_2) > 0).all())
    return all(_end(law, kind, end) == end for end in (min(1.0, *x), max(1.0, *x)))


def smallest_stiffness(
    law: Member, kind: str, x: Array, stretch_2: Array | None = None, dead_loads: bool = False
) -> Array:
    """Return the smallest eigenvalue of a stiffness above, (n,); NaN where there is no stress."""
    s = stretches(law, kind, x, stretch_2)
    stress, A = law.stress(s), law.tangent(s)
    A = (A + np.swapaxes(A, -1, -2)) / 2
    normal = s ** (-1.0 if dead_loads else 0.0)  # the gradient of log J
    with np.errstate(invalid="ignore"):  # infinite stresses
        if not dead_loads:
            A = np.einsum("ni,nij,nj->nij", s, A, s)
            A[:, range(3), range(3)] += s * stress
        elif law.nu is None:
            p = s[:, 2] * stress[:, 2]
            other = np.zeros_like(A)
            for i, j, k in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
                other[:, i, j] = other[:, j, i] = s[:, k]
            A = A - p[:, None, None] * other
    finite: npt.NDArray[np.bool_] = np.isfinite(A).all(axis=(-1, -2))
    finite &= np.isfinite(response(law, kind, x, stretch_2))
    A = np.where(finite[:, None, None], A, 0.0)
    if law.nu is None:
        A = _tangential(A, normal)
    return np.where(finite, np.linalg.eigvalsh(A)[:, 0], np.nan)


def _tangential(A: Array, normal: Array) -> Array:
    """Return (n, 2, 2), the matrices (n, 3, 3) on the planes normal to ``normal`` (n, 3)."""
    _, _, basis = np.linalg.svd(normal[:, None, :])
    plane = basis[:, 1:, :]
    return np.einsum("nai,nij,nbj->nab", plane, A, plane)


def _end(law: Member, kind: str, end: float, dead_loads: bool = False) -> float:
    """Return the end of the stable range between 1 and ``end``."""
    if end == 1.0:
        return 1.0
    x: Array = np.asarray(np.geomspace(1.0, end, _SAMPLES + 1), dtype=np.float64)
    unstable = ~(smallest_stiffness(law, kind, x, None, dead_loads) > 0)
    if not unstable.any():
        return end
    first = int(np.argmax(unstable))
    if first == 0:
        return 1.0
    good, bad = x[first - 1], x[first]
    for _ in range(_BISECTIONS):
        middle = np.sqrt(good * bad)
        if smallest_stiffness(law, kind, np.array([middle]), None, dead_loads)[0] > 0:
            good = middle
        else:
            bad = middle
    return float(good)
