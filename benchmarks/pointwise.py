"""Pointwise errors of every material and filter at extreme F, against a 50-digit oracle.

The table of docs/results/extremes_pointwise.md: F of any orientation, every eigensolver. The bounds
are those of `benchmarks.point_bounds`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pandas as pd
from mpmath import mpf
from scipy.spatial.transform import Rotation

from benchmarks import Row, point_bounds
from benchmarks.point_bounds import (
    STRAINED,
    STRETCHED,
    Exact,
    digits,
    evaluate,
    exactly,
    norm,
    perturbed,
    stretches,
)
from fem_snh import materials
from fem_snh.choices import EIGENSOLVERS
from fem_snh.kernels.material import Material
from fem_snh.materials.energy import Energy

Array = npt.NDArray[np.float64]

#: Strains of bodies that are turned as well.
_TURNED = ("turned 1e-9", "turned 1e-4")


@dataclass
class Oracle(Exact):
    """Energy, stress and Hessian of a material at any F; U and V are the rotations of its SVD."""

    U: Any = None
    V: Any = None

    def hessian(self, filter: str = "exact") -> Any:
        """Return d2psi/dF2 (9, 9) after the filter."""
        Q, Y = np.kron(self.V, self.U), super().hessian(filter)
        Y = np.stack([Q[:, rows := np.flatnonzero(y)] @ y[rows] for y in Y.T], axis=1)
        H = np.empty((9, 9), dtype=object)
        for i in range(9):
            H[i, i:] = H[i:, i] = [mpmath.fdot(row, Y[i]) for row in Q[i:]]
        return H


def oracle(energy: Energy, F: Any) -> Oracle:
    """Evaluate an energy at F, a (3, 3) array of mpmath numbers."""
    U, s, V = rotation_variant_svd(F)
    at = evaluate(energy, s)
    P = None if at.P is None else (U * np.diag(at.P)) @ V.T
    return Oracle(at.energy, at.terms, P, at.blocks, U, V)


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


def _random_rotation(rng: np.random.Generator) -> Array:
    return np.asarray(Rotation.random(random_state=int(rng.integers(2**31))).as_matrix())


def _with_stretches(s: Array, kind: int, rng: np.random.Generator) -> Array:
    """Return F with the stretches s, rotated from both sides, from the left only, or along axes.

    In the first kind the rounding of the entries changes small stretches beside large ones; F is
    then the exact input all the same.
    """
    if kind % 3 == 0:
        return _random_rotation(rng) * s @ _random_rotation(rng).T
    if kind % 3 == 1:
        return _random_rotation(rng) * s
    axes = np.eye(3)[rng.permutation(3)]
    axes[0] *= np.linalg.det(axes)
    return axes * s


def _strained(name: str, k: int, rng: np.random.Generator) -> Array:
    """Return F = I + strain A, or its rotation; A is symmetric, any, or traceless, in turns."""
    kind, strain = name.split()
    A = rng.uniform(-1, 1, (3, 3))
    if k % 3 == 0:
        A = (A + A.T) / 2
    elif k % 3 == 2:
        A -= np.trace(A) / 3 * np.eye(3)
    F = np.eye(3) + float(strain) * A
    return _random_rotation(rng) @ F if kind == "turned" else F


def deformations(seed: int = 0) -> dict[str, Array]:
    """Return a deformation gradient (3, 3) of every group by its name."""
    rng = np.random.default_rng(seed)
    found = {name: _with_stretches(stretches(name, rng), seed, rng) for name in STRETCHED}
    return found | {name: _strained(name, seed, rng) for name in (*STRAINED, *_TURNED)}


def samples(m: Material, number: int) -> Iterator[tuple[str, Any, list[Oracle]]]:
    """Yield an F of each group, with the exact values at F and at the perturbed ones."""
    rng = np.random.default_rng(number)
    for name, F in deformations(number).items():
        with mpmath.workdps(digits(F)):
            yield name, F, [oracle(m.expression, x) for x in perturbed(F, rng)]


def measure(material: str, quick: bool = False) -> list[Row]:
    """Return the rows of a material (`benchmarks.point_bounds.measure`)."""
    return list(point_bounds.measure(material, quick, samples=samples, eigensolvers=EIGENSOLVERS))


def rows(names: str = "", quick: bool = False) -> Iterator[Row]:
    """Measure the materials ``names``, by default all built-in ones.

    Yields
    ------
    dict
        One row per quantity: the number of F, those where the bound leaves a digit, the worst
        ratio of an error to its bound, and where it occurs.
    """
    chosen = names.split(",") if names else materials.names()
    table = pd.DataFrame([row for name in chosen for row in measure(name, quick)])
    for quantity, group in table.groupby("quantity", sort=False):
        worst = group.loc[group["ratio"].idxmax()]
        yield {
            "quantity": quantity,
            "F": len(group),
            "decided": int(group["digits"].sum()),
            "worst error / bound": round(float(worst["ratio"]), 3),
            "where": f"{worst['material']}, nu = {worst['nu']:g}, {worst['group']}",
            "ok": bool(group["passed"].all()),
        }
