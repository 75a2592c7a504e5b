"""Accuracy and cost of three eigensolvers for the 3x3 scaling block of Stable Neo-Hookean.

The block (Smith et al. 2018, eq. 13 and 14) is filtered with the eigenpairs of

``cubic``    eigen3.h, the default: one root of the characteristic cubic, then a 2x2 block
``jacobi``   eigen3.h: cyclic Jacobi rotations
``printed``  the formulas of the paper: three roots of eq. 42, the vectors of eq. 44

and compared with the same in 50 digits. Errors are relative to the norm of the block.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt

from benchmarks import Row, page_tables
from fem_snh.choices import EIGENSOLVERS
from fem_snh.kernels.material import Material, eigen3, material

Array = npt.NDArray[np.float64]

#: Indices of F_00, F_11, F_22 in vec(F): the scaling block of a diagonal F.
_DIAGONAL = (0, 4, 8)


def stretches(n: int, seed: int = 0) -> dict[str, Array]:
    """Return n principal stretches (n, 3) of each kind that is hard for an eigensolver."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], (n, 3))
    anything = rng.uniform(-2, 2, (n, 3))
    small = rng.standard_normal((n, 3)) * 10.0 ** rng.uniform(-16, -4, (n, 1))
    size = 10.0 ** rng.uniform(-8, 8, (n, 1))
    zeros = np.array([[1, 1, 0], [1, 0, 0], [0, 0, 0]])[rng.integers(0, 3, n)]
    hobak = np.array([[2.0, 3, 5], [-2, 3, 5], [-2, -3, -5]])
    return {
        "(2,3,5), (-2,3,5), (-2,-3,-5)": hobak[np.arange(n) % 3],
        "random in -2..2": anything,
        "small strain, differences 1e-4..1e-16": 1 + small,
        "all equal, 1e-8..1e8": np.repeat(size, 3, axis=1),
        "two equal": anything[:, [0, 0, 1]],
        "near-equal, 1e-8..1e8": size * (signs[:, :1] + small),
        "zero: plane, line, point": anything * zeros,
        "inverted": abs(anything) * [1, 1, -1],
        "signed, each 1e-8..1e8": signs * 10.0 ** rng.uniform(-8, 8, (n, 3)),
    }


def cubic_coefficients(s: Any, eta: Any, rho: Any) -> tuple[Any, Any, Any]:
    """Return c_2, c_1, c_0 of eq. 42 (of eq. 66 for eta = 0), in any arithmetic."""
    J, I_C = s[0] * s[1] * s[2], s[0] ** 2 + s[1] ** 2 + s[2] ** 2
    g = (s[1] * s[2]) ** 2 + (s[0] * s[2]) ** 2 + (s[0] * s[1]) ** 2
    c2 = -g * rho - I_C * eta
    c1 = -(1 + 2 * J * rho) * I_C - 6 * J * eta + (g * I_C - 9 * J**2) * rho * eta
    c0 = -(2 + 3 * J * rho) * J + (I_C**2 - 4 * g) * eta + 2 * J * (I_C**2 - 3 * g) * rho * eta
    return c2, c1, c0


def cubic_vector(s: Any, root: Any, eta: Any, rho: Any) -> tuple[Any, Any, Any]:
    """Return the diagonal of D_k, eq. 44 (eq. 67 for eta = 0), not normalised.

    The paper prints alpha_1 with s0^2 - s1^2 + s2^2; it is an eigenvector with s0^2 - s1^2 - s2^2.
    """
    s0, s1, s2 = s
    J, both = s0 * s1 * s2, rho * eta
    d, d0, d1 = s0**2 - s1**2, s0**2 - s2**2, s1**2 - s2**2
    return (
        root * (s1 + s0 * s2 * eta + J * s1 * rho)
        + (s0 * s2 + s1 * (d + s2**2) * eta + J * s0 * s2 * rho + s0 * d * s2 * d1 * both),
        root * (s0 + s1 * s2 * eta + J * s0 * rho)
        + (s1 * s2 - s0 * (d - s2**2) * eta + J * s1 * s2 * rho - s1 * d * s2 * d0 * both),
        root**2
        - root * (s0**2 + s1**2) * (eta + s2**2 * rho)
        - (s2**2 + 2 * J * eta + 2 * J * s2**2 * rho - (d * s2) ** 2 * both),
    )


def paper_terms(m: Material, s: Any) -> tuple[Any, Any, Any, Any]:
    """Return gamma_I, gamma_H, eta, rho of eq. 43 and 45 for stable_neo_hookean ``m``.

    The scaling block is gamma_I I + gamma_H (H + rho g g^T + eta f f^T).
    """
    mu, lam = m.expression.values
    J, I_C = s[0] * s[1] * s[2], s[0] ** 2 + s[1] ** 2 + s[2] ** 2
    if "I_C + 1" in str(m.expression.psi):  # with the barrier, eq. 14
        gamma_H = lam * (J - 1) - 3 * mu / 4
        return mu * (1 - 1 / (I_C + 1)), gamma_H, 2 * mu / ((I_C + 1) ** 2 * gamma_H), lam / gamma_H
    gamma_H = lam * (J - 1) - mu
    return mu * (1 + 0 * J), gamma_H, 0 * J, lam / gamma_H


def printed(m: Material, sigma: Array) -> Array:
    """Return the clamped scaling blocks (n, 3, 3) by the formulas of the paper."""
    clamped = []
    for s in sigma:
        gamma_I, gamma_H, eta, rho = paper_terms(m, s)
        block = np.zeros((3, 3))
        for root in np.roots([1.0, *cubic_coefficients(s, eta, rho)]).real:
            d = np.array(cubic_vector(s, root, eta, rho))
            d /= np.linalg.norm(d)
            block += max(gamma_H * root + gamma_I, 0.0) * np.outer(d, d)
        clamped.append(block)
    return np.array(clamped)


def blocks(m: Material, sigma: Array) -> Array:
    """Return the scaling blocks (n, 3, 3) at stretches (n, 3), from the kernel."""
    H = m.hessian(sigma[:, :, None] * np.eye(3))
    return np.asarray(H[:, _DIAGONAL][:, :, _DIAGONAL])


def reference(A: Array) -> Array:
    """Return A (n, 3, 3) with negative eigenvalues set to 0, computed in 50 digits."""
    with mpmath.workdps(50):
        out = []
        for block in A:
            values, Q = mpmath.eigsy(mpmath.matrix(block.tolist()))
            clamped = Q * mpmath.diag([max(v, 0) for v in values]) * Q.T
            out.append(np.array(clamped.tolist(), dtype=float))
    return np.array(out)


def clamp(A: Array, eigensolver: str) -> Array:
    """Return A (n, 3, 3) with negative eigenvalues set to 0 by one of our eigensolvers."""
    e, Q = eigen3(A, eigensolver)
    return np.asarray((Q * np.maximum(e, 0)[:, None, :]) @ np.swapaxes(Q, 1, 2))


def errors(sigma: Array, materials: list[Material]) -> dict[str, float]:
    """Return the largest error of each eigensolver over these stretches; nan if it fails."""
    worst = dict.fromkeys((*EIGENSOLVERS, "printed"), 0.0)
    for m in materials:
        A = blocks(m, sigma)
        norm = np.maximum(abs(A).sum(axis=2).max(axis=1), np.finfo(float).tiny)
        exact = reference(A)
        with np.errstate(all="ignore"):
            results = {name: clamp(A, name) for name in EIGENSOLVERS} | {
                "printed": printed(m, sigma)
            }
        for name, found in results.items():
            error = float(np.max(abs(found - exact).max(axis=(1, 2)) / norm))
            worst[name] = max(error, worst[name]) if error == error else error
    return worst


def _nanoseconds(calls: dict[str, Any], points: int, repeats: int) -> dict[str, float]:
    """Return the best time of each call [ns per point]; the calls are timed in turns."""
    best = dict.fromkeys(calls, np.inf)
    for _ in range(repeats):
        for name, call in calls.items():
            start = perf_counter()
            call()
            best[name] = min(best[name], perf_counter() - start)
    return {name: 1e9 * seconds / points for name, seconds in best.items()}


def rows(samples: int = 30, points: int = 2000, seed: int = 0, write: str = "") -> Iterator[Row]:
    """Measure error and cost for each kind of stretches.

    Parameters
    ----------
    samples, points : int
        Numbers of stretches for the errors and for the timings.
    write : str
        A page whose table is replaced by these rows: docs/results/eigensolver.md.

    Yields
    ------
    dict
        ``*_error``, relative to the norm of the block; ``*_eigen3_ns``, time of the eigensolver
        alone, and ``*_hessian_ns``, of the clamped 9x9 Hessian [ns per point]; ``ratio``, of the
        latter with jacobi to that with cubic.
    """
    parts = page_tables.split_page(Path(write), "eigensolvers") if write else ("", "")
    done = []
    materials = [material("stable_neo_hookean", nu=nu) for nu in (0.49, 0.3)]
    rotations = np.linalg.qr(np.random.default_rng(seed).standard_normal((2, 3, 3)))[0]
    for kind, sigma in stretches(samples, seed).items():
        row: Row = {"stretches": kind, "samples": samples}
        row |= {f"{name}_error": value for name, value in errors(sigma, materials).items()}
        many = stretches(points, seed)[kind]
        A = blocks(materials[0], many)
        F = rotations[0] @ (many[:, :, None] * np.eye(3)) @ rotations[1]
        alone = {name: lambda name=name: eigen3(A, name) for name in EIGENSOLVERS}
        whole = {n: lambda n=n: materials[0].hessian(F, "clamp", n) for n in EIGENSOLVERS}
        ns = {"eigen3": _nanoseconds(alone, points, 50), "hessian": _nanoseconds(whole, points, 50)}
        row |= {f"{n}_{what}_ns": round(ns[what][n], 1) for what in ns for n in EIGENSOLVERS}
        row["ratio"] = round(ns["hessian"]["jacobi"] / ns["hessian"]["cubic"], 3)
        done.append(row)
        yield row
    if write:
        page_tables.write_table(Path(write), "eigensolvers", parts, table(done))


def table(found: list[Row]) -> str:
    """Return the rows as a Markdown table."""
    head = ("stretches", "cubic", "jacobi", "printed", "cubic ns", "jacobi ns", "Hessian ratio")
    lines = [
        [
            row["stretches"],
            *(f"{row[f'{name}_error']:.0e}" for name in (*EIGENSOLVERS, "printed")),
            *(f"{row[f'{name}_eigen3_ns']:.0f}" for name in EIGENSOLVERS),
            f"{row['ratio']:.2f}",
        ]
        for row in found
    ]
    return page_tables.markdown_table(head, lines)
