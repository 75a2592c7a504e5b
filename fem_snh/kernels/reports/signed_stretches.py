"""Evaluate an energy at stretches of any signs, without the sign convention of an SVD."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy

from fem_snh.kernels.reports.evaluate import Array
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import INVARIANTS, SIGMA

_PAIRS = ((1, 2), (0, 2), (0, 1))  # that twist and flip couple


class Signed:
    """Energy, principal stresses and eigenvalues at stretches (..., 3) of any signs.

    All values are NaN outside the domain. They are evaluated from the symbolic expression, because
    the kernels compute an SVD with one convention for the sign.
    """

    def __init__(self, energy: Energy) -> None:
        self._values = energy.values
        psi = energy.psi_sigma
        slopes = energy.slopes
        second = [[sympy.diff(p, s) for s in SIGMA] for p in slopes]
        self._psi = self._function(energy, [sympy.Integer(0) if psi is None else psi])
        self._slopes = self._function(energy, list(slopes))
        self._second = self._function(energy, [a for row in second for a in row])
        self._domain = self._function(energy, [d.subs(INVARIANTS) for d in energy.domain])

    @staticmethod
    def _function(energy: Energy, expressions: list[sympy.Expr]) -> Any:
        modules = [{"where": lambda x, a, b: np.where(x > 0, a, b)}, "numpy"]
        return sympy.lambdify((*SIGMA, *energy.constants), expressions, modules=modules, cse=True)

    def _call(self, function: Any, s: Array) -> Array:
        """Return the values (..., number of expressions); NaN outside the domain."""
        with np.errstate(all="ignore"):
            found = function(*np.moveaxis(s, -1, 0), *self._values)
        outside = np.zeros(s.shape[:-1], dtype=bool)
        with np.errstate(all="ignore"):
            for d in self._domain(*np.moveaxis(s, -1, 0), *self._values):
                outside |= ~(np.asarray(d) > 0)
        out = np.stack([np.broadcast_to(f, s.shape[:-1]) for f in found], axis=-1).astype(float)
        return np.where(outside[..., None], np.nan, out)

    def energy(self, s: Array) -> Array:
        """Return psi [Pa], shape (...); 0 for a material without an energy."""
        return self._call(self._psi, s)[..., 0]

    def stress(self, s: Array) -> Array:
        """Return dpsi/ds_i [Pa], shape (..., 3)."""
        return self._call(self._slopes, s)

    def eigenvalues(self, s: Array) -> Array:
        """Return the eigenvalues [Pa] of the Hessian at unequal stretches, ascending, (..., 9).

        The twist eigenvalue of two opposite stretches is infinite.
        """
        p, A = self.stress(s), self._call(self._second, s).reshape(*s.shape[:-1], 3, 3)
        finite = np.asarray(np.isfinite(A).all(axis=(-1, -2), keepdims=True))
        block = np.linalg.eigvalsh(np.where(finite, (A + np.swapaxes(A, -1, -2)) / 2, 0))
        pairs = []
        with np.errstate(all="ignore"):
            for j, k in _PAIRS:
                pairs.append((p[..., j] + p[..., k]) / (s[..., j] + s[..., k]))
                pairs.append((p[..., j] - p[..., k]) / (s[..., j] - s[..., k]))
        values = np.concatenate([block, np.stack(pairs, axis=-1)], axis=-1)
        return np.where(finite[..., 0], np.sort(values, axis=-1), np.nan)
