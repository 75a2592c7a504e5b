r"""Stable ranges of a fit: Drucker's criterion along the three tests with free sides.

A state is stable if :math:`dP : dF > 0` for all changes of the principal stretches, which for an
incompressible material keep the volume:

.. math::

    \sum_{ij} ds_i \left(\frac{\partial^2\psi}{\partial s_i \partial s_j}
    - p \frac{\partial^2 J}{\partial s_i \partial s_j}\right) ds_j > 0, \qquad
    p = s_2 \frac{\partial\psi}{\partial s_2}

These are the scaling eigenvalues of the material reports (`fem_snh.kernels.reports.drucker`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fem_snh.studies.fit.responses import FREE, Law, response, stretches

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


def stable_ranges(law: Law, low: float, high: float) -> tuple[StableRange, ...]:
    """Return the stable ranges of the uniaxial, the equibiaxial and the planar test.

    Parameters
    ----------
    law : Law
        The energy.
    low, high : float
        The range of stretches that is searched, around 1.
    """
    return tuple(
        StableRange(kind, _end(law, kind, low), _end(law, kind, high), (low, high)) for kind in FREE
    )


def stable_at(law: Law, kind: str, x: Array, stretch_2: Array | None = None) -> bool:
    """Return whether a material is stable at the data of a test.

    Those of a biaxial test are its points (n,), those of the others all from rest to the last one.
    """
    if kind == "biaxial":
        return bool((smallest_stiffness(law, kind, x, stretch_2) > 0).all())
    return all(_end(law, kind, end) == end for end in (min(1.0, *x), max(1.0, *x)))


def smallest_stiffness(law: Law, kind: str, x: Array, stretch_2: Array | None = None) -> Array:
    """Return the smallest eigenvalue of the stiffness above, (n,); NaN where there is no stress."""
    s = stretches(law, kind, x, stretch_2)
    A = law.tangent(s)
    A = (A + np.swapaxes(A, -1, -2)) / 2
    if law.nu is None:
        p = s[:, 2] * law.stress(s)[:, 2]
        other = np.zeros_like(A)
        for i, j, k in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            other[:, i, j] = other[:, j, i] = s[:, k]
        with np.errstate(invalid="ignore"):  # infinite stresses
            A = A - p[:, None, None] * other
        A = _tangential(A, 1 / s)  # the gradient of J
    finite = np.isfinite(A).all(axis=(-1, -2)) & np.isfinite(response(law, kind, x, stretch_2))
    values = np.linalg.eigvalsh(np.where(finite[:, None, None], A, 0.0))[:, 0]
    return np.where(finite, values, np.nan)


def _tangential(A: Array, normal: Array) -> Array:
    """Return (n, 2, 2), the matrices (n, 3, 3) on the planes normal to ``normal`` (n, 3)."""
    _, _, basis = np.linalg.svd(normal[:, None, :])
    plane = basis[:, 1:, :]
    return np.einsum("nai,nij,nbj->nab", plane, A, plane)


def _end(law: Law, kind: str, end: float) -> float:
    """Return the end of the stable range between 1 and ``end``."""
    if end == 1.0:
        return 1.0
    x: Array = np.asarray(np.geomspace(1.0, end, _SAMPLES + 1), dtype=np.float64)
    unstable = ~(smallest_stiffness(law, kind, x) > 0)
    if not unstable.any():
        return end
    first = int(np.argmax(unstable))
    if first == 0:
        return 1.0
    good, bad = x[first - 1], x[first]
    for _ in range(_BISECTIONS):
        middle = np.sqrt(good * bad)
        if smallest_stiffness(law, kind, np.array([middle]))[0] > 0:
            good = middle
        else:
            bad = middle
    return float(good)
