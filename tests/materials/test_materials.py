"""The registry of materials, and what normalisation promises of every one of them."""

from __future__ import annotations

import numpy as np
import pytest
from points import deformations, every_material, make, vec

import fem_snh
from fem_snh.errors import BadInput

pytestmark = pytest.mark.one_debian


def hooke(E: float, nu: float) -> np.ndarray:
    """Linear elasticity d(sigma)/d(grad u), (9, 9): 2 mu eps + lambda tr(eps) I."""
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    eye = np.eye(3)
    C = lam * np.einsum("ij,kl->ijkl", eye, eye)
    C += mu * (np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye))
    return C.reshape(9, 9)  # symmetric in (i, j): rows or columns first are the same


# --- registry ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"E": 0.0}, ["E = 0.0", "from 1e-100 to 1e+100"]),
        ({"E": -1.0}, ["E = -1.0"]),
        ({"E": float("nan")}, ["E = nan"]),
        ({"E": float("inf")}, ["E = inf"]),
        ({"nu": 0.51}, ["nu = 0.51", "-1", "0.5"]),
        ({"nu": -1.0}, ["nu = -1.0"]),
        ({"nu": float("nan")}, ["nu = nan"]),
        ({"no_such_shape": 1.0}, ["no_such_shape", "E, nu"]),
    ],
)
def test_mistakes_are_one_line(given, words):
    with pytest.raises(BadInput) as caught:
        fem_snh.material("stvk", **given)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words)


# --- normalisation and rest ----------------------------------------------------------------------


@every_material
def test_rest(m):
    """psi = 0, P = 0, and small strains obey Hooke's law, in every orientation."""
    m = make(*m)
    F = np.concatenate([np.eye(3)[None], deformations(np.ones((20, 3)))])
    scale = np.linalg.norm(hooke(m.expression.E, m.expression.nu))
    assert abs(m.energy(F)).max() <= 1e-14 * scale
    assert abs(m.pk1(F)).max() <= 1e-14 * scale
    assert abs(m.hessian(F[0]) - hooke(m.expression.E, m.expression.nu)).max() <= 1e-14 * scale
    # By the stress alone: P(I + h G) = h C:G + O(h^2), the error by order.
    G = np.random.default_rng(1).standard_normal((3, 3))
    linear = hooke(m.expression.E, m.expression.nu) @ vec(G)
    h = 2.0 ** -np.arange(8, 14)
    error = [np.linalg.norm(vec(m.pk1(np.eye(3) + x * G)) / x - linear) for x in h]
    assert np.polyfit(np.log(h), np.log(error), 1)[0] == pytest.approx(1, abs=0.05)
