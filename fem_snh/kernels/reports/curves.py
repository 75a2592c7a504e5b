"""Stress-stretch curves in four standard tests, and the stretches with a positive tangent.

The curves are compared with linear elasticity: the PK1-linearisation of every material, which is
the corotational energy (Chen & Barbic, theorem 3.1). It is invariant under rotations, so its curve
is a straight line in all tests but the shear.

The tangent is the 9x9 Hessian d2psi/dF2. Smith et al. 2018 (section 3.3) relate its positive
semidefiniteness to Drucker's stability. Under compression the tangent of every material is
indefinite: the twist eigenvalues (p_j + p_k)/(s_j + s_k) are negative, because a compressed element
may rotate as a strut buckles. Therefore the smallest of the three scaling eigenvalues, which
excludes rotations, is also reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from fem_snh.arrays import Array, ArrayLike
from fem_snh.kernels.material import Material, svd

#: A test: a function that returns the three stretches (..., 3) from the prescribed and the free
#: stretch, and the index of a direction with the free stretch.
Test = tuple[Callable[[Array, Array], Array], int]

UNIAXIAL: Test = (lambda s, t: np.stack([s, t, t], axis=-1), 2)
EQUIBIAXIAL: Test = (lambda s, t: np.stack([s, s, t], axis=-1), 2)

#: Grid of free stretches, between whose points sign changes of the lateral stress are found.
_FREE = np.geomspace(0.02, 50, 241)
#: Largest ratio of consecutive free stretches on one branch of solutions.
_JUMP = 1.6


def diagonal(s: ArrayLike) -> Array:
    """Return F = diag(s), shape (..., 3, 3), of stretches (..., 3)."""
    s = np.asarray(s, dtype=float)
    return s[..., None] * np.eye(3)


def inside(m: Material, F: Array) -> Array:
    """Return where the energy is finite, (...); without an energy, where F is finite."""
    finite = (
        np.isfinite(m.energy(F)) if m.expression.has_energy else np.isfinite(F).all(axis=(-1, -2))
    )
    return np.asarray(finite)


def stress(m: Material, s: ArrayLike) -> Array:
    """Return the diagonal of PK1 [Pa] at F = diag(s), (..., 3); NaN where psi is infinite."""
    F = diagonal(s)
    P = np.diagonal(m.pk1(F), axis1=-2, axis2=-1)
    return np.where(inside(m, F)[..., None], P, np.nan)


def eigenvalues(m: Material, s: ArrayLike) -> Array:
    """Return the tangent's eigenvalues [Pa] at F = diag(s), (..., 9), as `Material.eigensystem`.

    They are NaN where psi is infinite.
    """
    F = diagonal(s)
    return np.where(inside(m, F)[..., None], m.eigensystem(F)[0], np.nan)


@dataclass(frozen=True)
class Curve:
    """One test of a material.

    Attributes
    ----------
    name : str
        The test.
    x : numpy.ndarray
        Stretch, or amount of shear (n,).
    stress : numpy.ndarray
        PK1 [Pa] in the direction of the test (n,); NaN where there is no solution.
    linear : numpy.ndarray
        PK1 [Pa] of linear elasticity (n,).
    stretches : numpy.ndarray or None
        Principal stretches (n, 3); None for the shear.
    """

    name: str
    x: Array
    stress: Array
    linear: Array
    stretches: Array | None = None


def around_rest(low: float, high: float) -> Array:
    """Return 121 stretches from ``low`` to ``high``; the 61st is exactly 1."""
    return np.concatenate([np.geomspace(low, 1, 61)[:-1], np.geomspace(1, high, 61)])


def curves(m: Material) -> tuple[Curve, Curve, Curve, Curve]:
    """Return the four tests over their default ranges."""
    return uniaxial(m), equibiaxial(m), shear(m), volumetric(m)


def uniaxial(m: Material, x: Array | None = None) -> Curve:
    """Return the curve of P_00 against s_0 = x for uniaxial stress; s_1 = s_2 are free."""
    x = around_rest(0.25, 4) if x is None else np.asarray(x, dtype=float)
    s = _with_free_sides(m, UNIAXIAL, x)
    return Curve("uniaxial", x, stress(m, s)[:, 0], _young(m)[0] * (x - 1), s)


def equibiaxial(m: Material, x: Array | None = None) -> Curve:
    """Return the curve of P_00 against s_0 = s_1 = x for equibiaxial stress; s_2 is free."""
    x = around_rest(0.4, 3) if x is None else np.asarray(x, dtype=float)
    s = _with_free_sides(m, EQUIBIAXIAL, x)
    E, nu = _young(m)
    return Curve("equibiaxial", x, stress(m, s)[:, 0], E / (1 - nu) * (x - 1), s)


def volumetric(m: Material, x: Array | None = None) -> Curve:
    """Return the curve of P_00 against s_0 = s_1 = s_2 = x."""
    x = around_rest(0.3, 2) if x is None else np.asarray(x, dtype=float)
    s = np.repeat(x[:, None], 3, axis=1)
    mu, lam = m.lame
    return Curve("volumetric", x, stress(m, s)[:, 0], (2 * mu + 3 * lam) * (x - 1), s)


def shear(m: Material, x: Array | None = None) -> Curve:
    """Return the curve of P_01 against x for simple shear F = I + x e_0 e_1^T."""
    x = np.linspace(0, 3, 121) if x is None else np.asarray(x, dtype=float)
    F = np.tile(np.eye(3), (len(x), 1, 1))
    F[:, 0, 1] = x
    U, s, V = svd(F)
    finite = np.isfinite(stress(m, s)[:, 0])
    mu, lam = m.lame
    p = 2 * mu * (s - 1) + lam * (s.sum(axis=-1, keepdims=True) - 3)
    linear = np.einsum("ni,ni,ni->n", U[:, 0], p, V[:, 1])
    return Curve("simple shear", x, np.where(finite, m.pk1(F)[:, 0, 1], np.nan), linear)


def _with_free_sides(m: Material, test: Test, x: Array) -> Array:
    """Return the stretches (n, 3) without lateral stress, on the branch through the rest state.

    They are NaN beyond the branch's ends. Sign changes of the lateral stress are found on a grid.
    From the rest state outwards, the sign change nearest to the previous solution is refined.
    Solutions whose lateral stress decreases with the lateral stretch are unstable and left out.
    """
    stretches, free = test
    across = stress(m, stretches(*np.meshgrid(x, _FREE, indexing="ij")))[..., free]
    with np.errstate(invalid="ignore"):
        rising = (across[:, :-1] <= 0) & (across[:, 1:] > 0)
    t = np.full(len(x), np.nan)
    start = int(np.argmin(np.abs(x - 1)))
    for order in (range(start, len(x)), range(start, -1, -1)):
        previous = 1.0
        for n in order:
            found = np.flatnonzero(rising[n])
            middle = np.sqrt(_FREE[found] * _FREE[found + 1])
            near = np.exp(np.abs(np.log(middle / previous)))
            if not len(found) or (n != start and near.min() > _JUMP):
                break
            k = found[int(near.argmin())]
            t[n] = previous = _root(m, test, x[n], _FREE[k], _FREE[k + 1])
    return stretches(x, t)


def _across(t: float, m: Material, test: Test, s: float) -> float:
    """Return the stress [Pa] in the free direction for the stretches s, prescribed, and t, free."""
    stretches, free = test
    return float(stress(m, stretches(np.array(s), np.array(t)))[free])


def _root(m: Material, test: Test, s: float, low: float, high: float) -> float:
    """Return the free stretch between ``low`` and ``high`` that has no stress."""
    return float(brentq(_across, low, high, args=(m, test, s), xtol=1e-15, rtol=1e-14))


def _young(m: Material) -> tuple[float, float]:
    """Return (E [Pa], nu) of the material's small-strain constants (Chen & Barbic, eq. 14)."""
    mu, lam = m.lame
    return mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))


#: Planes in the space of stretches: s2 as a function of (s0, s1).
PLANES: dict[str, Callable[[Array, Array], Array]] = {
    "s2 = 1": lambda a, b: np.ones_like(a),
    "s2 = s1": lambda a, b: b,
}
#: Eigenvalues above -TOLERANCE [E] count as non-negative: at rest, three are 0 but for rounding.
TOLERANCE = 1e-8


@dataclass(frozen=True)
class StableRegion:
    """Smallest eigenvalues [Pa] over a plane of stretches; NaN where psi is infinite.

    Attributes
    ----------
    plane : str
        Key of `PLANES`.
    s0, s1 : numpy.ndarray
        The axes (n,).
    tangent : numpy.ndarray
        The smallest of the nine eigenvalues (n, n); row i has the stretch s1[i].
    scaling : numpy.ndarray
        The same for the three scaling eigenvalues.
    """

    plane: str
    s0: Array
    s1: Array
    tangent: Array
    scaling: Array


def smallest(m: Material, s: Array) -> tuple[Array, Array]:
    """Return the smallest of all eigenvalues and of the scaling ones [Pa], each (...)."""
    values = eigenvalues(m, s)
    return values.min(axis=-1), values[..., :3].min(axis=-1)


def region(m: Material, plane: str, axis: Array | None = None) -> StableRegion:
    """Return the smallest eigenvalues over a plane of `PLANES`, at s0 and s1 of ``axis`` (n,)."""
    axis = np.linspace(0.01, 3, 300) if axis is None else np.asarray(axis, dtype=float)
    s0, s1 = np.meshgrid(axis, axis)
    s = np.stack([s0, s1, PLANES[plane](s0, s1)], axis=-1)
    return StableRegion(plane, axis, axis, *smallest(m, s))


def regions(m: Material) -> tuple[StableRegion, ...]:
    """Return the `region` of each plane of `PLANES`, on the default axis."""
    return tuple(region(m, plane) for plane in PLANES)
