"""Deformation gradients at the extremes, in named groups."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]

#: Pairs (nu, E [Pa]), each combined with each group.
MODULI = (
    (-0.9, 1e-6), (-0.5, 1e3), (0.0, 1.0), (0.3, 1e12),
    (0.45, 1e-6), (0.49, 1.7), (0.4999, 1e6), (0.4999999, 1.0),
)  # fmt: skip
QUICK = ((-0.9, 1e12), (0.4999999, 1e-6))

STRAINS = (1e-4, 1e-6, 1e-9, 1e-12, 1e-15)
DIFFERENCES = (1e-4, 1e-6, 1e-8, 1e-12, 1e-16)


class Group(NamedTuple):
    """Deformation gradients (n, 3, 3) of one kind."""

    name: str
    F: Array


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


def _stretches(name: str, rng: np.random.Generator) -> Array:
    """Return three signed stretches of the group that ``name`` describes."""
    signs = rng.choice([-1.0, 1.0], 3)
    size, wide = 10.0 ** rng.uniform(-12, 12), 10.0 ** rng.uniform(-12, 12, 3)
    moderate = 10.0 ** rng.uniform(-1, 1, 3)
    kind, _, rest = name.partition(" ")
    match kind:
        case "regular":
            return moderate
        case "1e-12..1e12":
            return wide * (signs if rest else 1)
        case "equal":
            return size * (signs if rest else np.ones(3))
        case "near-equal":
            return 10.0 ** rng.uniform(-2, 2) * (1 + float(rest) * rng.standard_normal(3))
        case "pair":
            d = float(rest) * rng.standard_normal()
            return moderate[[0, 0, 1]] * np.array([1 + d, 1, rng.choice([1, -1])])
        case "mirrored":
            return np.array([1.0, 1.0, -1.0]) + float(rest) * rng.standard_normal(3)
        case "zero":
            return moderate * (np.arange(3) >= int(rest))
        case "negative":
            return moderate * np.where(np.arange(3) < int(rest), -1, 1)
    raise ValueError(name)


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


STRETCHED = (
    "regular", "1e-12..1e12", "1e-12..1e12 signed", "equal", "equal signed",
    *(f"near-equal {d:g}" for d in DIFFERENCES), *(f"pair {d:g}" for d in DIFFERENCES),
    "mirrored 0", "mirrored 1e-4", "mirrored 1e-9", "zero 1", "zero 2", "zero 3",
    "negative 1", "negative 2", "negative 3",
)  # fmt: skip
STRAINED = (*(f"strain {e:g}" for e in STRAINS), "turned 1e-9", "turned 1e-4")


def groups(n: int, seed: int = 0) -> Iterator[Group]:
    """Yield every group, with n points each."""
    rng = np.random.default_rng(seed)
    for name in STRETCHED:
        yield Group(
            name,
            np.array([_with_stretches(_stretches(name, rng), k + seed, rng) for k in range(n)]),
        )
    for name in STRAINED:
        yield Group(name, np.array([_strained(name, k + seed, rng) for k in range(n)]))
