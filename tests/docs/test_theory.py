"""The numbers and formulas of docs/theory, against the code that they describe.

``python tests/docs/test_theory.py`` writes the C excerpt of the walk-through again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from paths import ROOT

import fem_snh
from fem_snh.kernels.codegen.c_functions import Functions

pytestmark = pytest.mark.one_debian

THEORY = ROOT / "docs" / "theory"
EXCERPT = THEORY / "hessian_stretches.c"
#: The deformation gradient of the walk-through (docs/theory/clamped_hessian.md).
F = np.array([[0.9, -0.48, -0.64], [1.2, 0.36, 0.48], [0.0, 0.4, -0.3]])
MU, LAM = 1.0, 10.0


def material() -> Any:
    return fem_snh.material("stable_neo_hookean", E=2.9, nu=0.45)


def generated() -> str:
    return Functions(material().expression).hessian_function()


def matrices_on(page: str) -> list[np.ndarray]:
    """The typeset matrices of a page, rows separated by a double backslash, as arrays."""
    text = (THEORY / page).read_text()
    found = []
    for part in text.split(r"\begin{pmatrix}")[1:]:
        rows = part.partition(r"\end{pmatrix}")[0].split(r"\\")
        try:
            found.append(np.array([[float(x) for x in row.split("&")] for row in rows]))
        except ValueError:  # a matrix of symbols
            continue
    return found


def test_excerpt_of_the_walk_through_is_what_the_generator_makes() -> None:
    assert EXCERPT.read_text() == generated(), "run: python tests/docs/test_theory.py"


def test_walk_through_constants_and_svd() -> None:
    assert material().expression.values == pytest.approx((MU, LAM))
    F_page, U, V, *_ = matrices_on("clamped_hessian.md")
    assert np.array_equal(F_page, F)
    for rotation in (U, V):
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(rotation) == pytest.approx(1)
    assert np.allclose(U @ np.diag([1.5, 1, -0.5]) @ V.T, F, atol=1e-15)
    assert np.linalg.det(F) == pytest.approx(-0.75)


def test_walk_through_eigenvalues_and_blocks() -> None:
    s, slope = np.array([1.5, 1, -0.5]), LAM * (-0.75 - 1) - MU
    assert slope == -18.5
    twist, flip = MU + s * slope, MU - s * slope
    _, _, _, A, positive, *pairs, _ = matrices_on("clamped_hessian.md")
    minors = -0.75 / s
    expected = LAM * np.outer(minors, minors) + slope * np.array(
        [[0, s[2], s[1]], [s[2], 0, s[0]], [s[1], s[0], 0]]
    )
    assert np.allclose(A, expected + MU * np.eye(3), atol=1e-13)
    values, _ = material().eigensystem(F)
    assert np.allclose(values[3:], [*twist, *flip])
    assert np.allclose(values[:3], [67.6237, -7.2661, -26.7326], atol=5e-5)
    assert np.allclose(values[:3], np.linalg.eigvalsh(A)[::-1])
    e, Q = np.linalg.eigh(A)
    assert np.allclose(positive, (Q * np.maximum(e, 0)) @ Q.T, atol=5e-5)
    for i, pair in enumerate(pairs):
        t, f = max(twist[i], 0), max(flip[i], 0)
        assert np.allclose(pair, [[f + t, f - t], [f - t, f + t]])


def test_walk_through_matrix() -> None:
    page = matrices_on("clamped_hessian.md")[-1]
    clamped = material().hessian(F, filter="clamp")
    assert np.allclose(page, clamped, atol=5e-5)
    expected = [0, 0, 0, 0, 0, 10.25, 19.5, 28.75, 67.6237]
    assert np.allclose(np.linalg.eigvalsh(clamped), expected, atol=5e-5)


def test_twist_and_flip_of_an_energy_of_the_invariants() -> None:
    m = fem_snh.material("stvk", E=2.0, nu=0.3)
    mu, lam = m.expression.values
    s = np.array([1.4, 0.9, -0.6])
    I_C = (s**2).sum()
    psi_C, psi_II = mu * (2 * I_C - 2) / 4 + lam / 4 * (I_C - 3), -mu / 2
    values, _ = m.eigensystem(np.diag(s))
    for i, (j, k) in enumerate(((1, 2), (0, 2), (0, 1))):
        a, b = sorted((s[j], s[k]))
        for sign, found in ((1, values[3 + i]), (-1, values[6 + i])):
            common = 2 * psi_C + 2 * psi_II * (I_C - a**2 + sign * a * b - b**2)
            assert found == pytest.approx(common)  # psi_J = 0


if __name__ == "__main__":
    EXCERPT.write_text(generated())
