"""Evaluate energy, stress and Hessian of a material in as many digits as requested, by mpmath.

The expression of the material is differentiated by sympy in the principal stretches and evaluated
at the exact values of the doubles in F and in the constants. Only the expression is shared with the
kernels. tests/test_pointwise_oracle.py checks the oracle against a stress by hand, mpmath's
derivatives of the energy, and a dense eigendecomposition of the 9x9 Hessian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mpmath
import numpy as np
import sympy
from mpmath import mpf

from fem_snh.materials.energy import Energy
from fem_snh.materials.functions import fractions
from fem_snh.materials.invariants import INVARIANTS, SIGMA

#: (i, j, k): twist and flip i couple the stretches j and k (Smith et al. 2018, eq. 46-48).
PAIRS = ((0, 1, 2), (1, 0, 2), (2, 0, 1))


def _terms(f: sympy.Expr) -> sympy.Expr:
    """Return the sum of the absolute values of the terms of f."""
    if f.is_Add:
        return sympy.Add(*map(_terms, f.args))
    return sympy.Mul(*map(_terms, f.args)) if f.is_Mul else sympy.Abs(f)


@lru_cache(maxsize=8)
def _calls(
    psi: sympy.Expr | None, slopes: Any, domain: Any, constants: Any
) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """Return functions for (domain), (psi, the size of its terms), (slopes, their derivatives)."""

    def call(expressions: Any) -> Callable[..., Any]:
        return sympy.lambdify((*SIGMA, *constants), expressions, "mpmath")

    psi = sympy.Integer(0) if psi is None else fractions(psi)
    slopes = [fractions(p) for p in slopes]
    second = [[sympy.diff(p, s) for s in SIGMA] for p in slopes]
    return (
        call([d.subs(INVARIANTS) for d in domain]),
        call([psi, _terms(psi)]),
        call([list(slopes), second]),
    )


@dataclass
class Point:
    """Energy, stress and Hessian of a material at one F, as mpmath numbers.

    ``blocks`` are those of the Hessian in the frame of the stretches: scaling (3x3), twist, flip.
    The columns of ``frame`` are 9-vectors by columns of F. P and ``blocks`` are None for energies
    of tr S where two signed stretches sum to zero.
    """

    inside: bool
    energy: Any = None  # +inf outside the domain; None without an energy
    terms: Any = 0  # the sum of the absolute values of the energy's terms
    P: Any = None
    frame: Any = None
    blocks: Any = None

    @property
    def eigenvalues(self) -> list[Any]:
        """Return all nine eigenvalues of the Hessian, ascending."""
        A, twist, flip = self.blocks
        return sorted([*mpmath.eigsy(mpmath.matrix(A.tolist()), eigvals_only=True), *twist, *flip])

    def hessian(self, filter: str = "exact") -> Any:
        """Return d2psi/dF2 (9, 9) after the filter."""
        A, twist, flip = self.blocks
        if filter != "exact":
            A, twist, flip = filtered(A, filter), *(_each(x, filter) for x in (twist, flip))
        Q, on = self.frame, [0, 4, 8]
        Y = np.empty((9, 9), dtype=object)  # Q times the blocks
        Y[:, on] = Q[:, on] @ A
        for i, j, k in PAIRS:
            a, b = 3 * k + j, 3 * j + k
            same, other = (twist[i] + flip[i]) / 2, (flip[i] - twist[i]) / 2
            # Arrays first: mpf * array would format the array for an error that numpy then catches.
            Y[:, a], Y[:, b] = Q[:, a] * same + Q[:, b] * other, Q[:, a] * other + Q[:, b] * same
        H = np.empty((9, 9), dtype=object)
        for i in range(9):
            H[i, i:] = H[i:, i] = [mpmath.fdot(row, Y[i]) for row in Q[i:]]
        return H


def _each(values: Any, filter: str) -> list[Any]:
    return [max(v, mpf(0)) if filter == "clamp" else abs(v) for v in values]


def filtered(A: Any, filter: str) -> Any:
    """Return a symmetric matrix with its eigenvalues clamped or made positive."""
    values, Q = mpmath.eigsy(mpmath.matrix(A.tolist()))
    Q = np.array(Q.tolist(), dtype=object).reshape(A.shape)
    return (Q * np.array(_each(values, filter), dtype=object)) @ Q.T


def exactly(F: Any) -> Any:
    """Return an array of doubles as mpmath numbers."""
    return np.vectorize(mpf, otypes=[object])(np.asarray(F, dtype=object))


def norm(A: Any) -> Any:
    """Return the Frobenius norm."""
    return mpmath.sqrt(mpmath.fsum(x * x for x in np.ravel(A)))


def _unit(v: Any) -> Any:
    return v / norm(v)


def rotation_variant_svd(F: Any) -> tuple[Any, Any, Any]:
    """Return U, s, V of F (Smith et al. 2018, eq. 2): rotations, s0 >= s1 >= |s2|."""
    _, Q = mpmath.eigsy(mpmath.matrix((F.T @ F).tolist()))
    V = np.array(Q.tolist(), dtype=object).reshape(3, 3)[:, ::-1]
    V[:, 2] = np.cross(V[:, 0], V[:, 1])
    G = F @ V
    tiny = mpf(10) ** (-mpmath.mp.dps // 4)
    s0, s1 = norm(G[:, 0]), norm(G[:, 1])
    u0 = exactly([1, 0, 0]) if s0 == 0 else G[:, 0] / s0
    if s1 <= tiny * s0:  # rank one: any normal of u0
        axis = exactly(np.eye(3)[int(np.argmin([abs(float(x)) for x in u0]))])
        u1, s1 = _unit(np.cross(u0, axis)), mpf(0)
    else:
        u1 = _unit(G[:, 1] - (G[:, 1] @ u0) * u0)
    u2 = np.cross(u0, u1)
    J = F[:, 0] @ np.cross(F[:, 1], F[:, 2])
    return np.stack([u0, u1, u2], axis=1), [s0, s1, J / (s0 * s1) if s1 else mpf(0)], V


class Oracle:
    """A material's energy, in the working precision of mpmath."""

    def __init__(self, energy: Energy) -> None:
        self.energy = energy
        self._domain, self._psi, self._slopes = _calls(
            energy.psi_sigma, energy.slopes, energy.domain, energy.constants
        )

    def __call__(self, F: Any) -> Point:
        """Evaluate the material at F, a (3, 3) array of mpmath numbers."""
        U, s, V = rotation_variant_svd(F)
        constants = [mpf(v) for v in self.energy.values]
        if any(d <= 0 for d in self._domain(*s, *constants)):
            return Point(False, energy=mpmath.inf if self.energy.has_energy else None)
        psi, terms = map(mpf, self._psi(*s, *constants))
        p, pp = self._slopes(*s, *constants)
        p = [mpf(x) for x in p]
        blocks = self._blocks(s, p, exactly(pp))
        point = Point(True, psi if self.energy.has_energy else None, terms, blocks=blocks)
        if blocks is not None:
            point.P = (U * np.array(p, dtype=object)) @ V.T
            pairs = [(a, b) for b in range(3) for a in range(3)]
            point.frame = np.stack([np.kron(V[:, b], U[:, a]) for a, b in pairs], axis=1)
        return point

    @staticmethod
    def _blocks(s: Any, p: Any, pp: Any) -> tuple[Any, list[Any], list[Any]] | None:
        """Return scaling, twist and flip: limits of the quotients where two stretches are equal."""
        A = (pp + pp.T) / 2  # of a stress that is no gradient: the symmetric part
        same = mpf(10) ** (-mpmath.mp.dps // 3)
        twist, flip = [], []
        for _, j, k in PAIRS:
            mean, size = (A[j, j] + A[k, k]) / 2, abs(s[j]) + abs(s[k])
            d, t = s[j] - s[k], s[j] + s[k]
            flip.append((p[j] - p[k]) / d if abs(d) > same * size else mean - A[j, k])
            if abs(t) > same * size:
                twist.append((p[j] + p[k]) / t)
            elif abs(p[j] + p[k]) <= same * (abs(p[j]) + abs(p[k])):
                twist.append(mean + A[j, k])
            else:
                return None
        return A, twist, flip
