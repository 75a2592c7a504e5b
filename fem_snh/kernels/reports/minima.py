"""Search for all equilibrium shapes of an element: descent from many deformation gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fem_snh.kernels.material import Material
from fem_snh.kernels.reports.evaluate import Array, inside
from fem_snh.kernels.svd_eigen import svd
from fem_snh.materials.normalise import lame

#: Number of starts, of which some are inverted, and the seed of their random numbers.
_STARTS, _SEED = 160, 0
#: Largest number of descent steps.
STEPS = 150
#: Eigenvalues below this [E] count as zero.
_FLAT = 1e-6
#: A stretch above this counts as infinite.
_FAR = 1e3
#: Minima whose stretches differ by less than this are the same.
_SAME = 1e-3


@dataclass(frozen=True)
class Minima:
    """Local minima of psi over all F.

    Attributes
    ----------
    stretches : numpy.ndarray
        Signed principal stretches (n, 3); the rest state, if it is a minimum, is first.
    hits : tuple of int
        Number of starts that ended in each minimum.
    starts : int
        Number of starts.
    collapsed : int
        Starts that fell below the energy of the rest state while a stretch tended to zero or
        infinity.
    lost : int
        Starts that had not converged when the descent stopped.
    """

    stretches: Array
    hits: tuple[int, ...]
    starts: int
    collapsed: int
    lost: int

    @property
    def rest(self) -> bool:
        """Return True if the rest state is a minimum."""
        return bool(len(self.stretches)) and bool(np.allclose(self.stretches[0], 1, atol=_SAME))

    @property
    def spurious(self) -> Array:
        """The stretches of the minima other than the rest state."""
        return self.stretches[1:] if self.rest else self.stretches

    def __str__(self) -> str:
        if self.rest and not len(self.spurious):
            found = "rest alone"
        else:
            others = [
                "(" + ", ".join(f"{x:.3g}" for x in np.round(s, 4) + 0.0) + ")"
                for s in self.spurious[:4]
            ]
            more = len(self.spurious) - len(others)
            found = ", ".join([*(["rest"] if self.rest else []), *others]) or "none"
            found += f" and {more} more" if more else ""
        if self.collapsed:
            found += f"; {self.collapsed} of {self.starts} starts collapsed"
        if self.lost > self.starts // 50:  # a few may need more steps
            found += f"; {self.lost} of {self.starts} starts lost"
        return found


def minima(m: Material) -> Minima:
    """Return a material's minima that are reached from random F of all sizes and orientations.

    At a minimum the Hessian has no negative eigenvalue and its scaling eigenvalues are positive. A
    stationary start that is no minimum, such as F = 0, is displaced at random.
    """
    rng = np.random.default_rng(_SEED)
    F = _starts(m, _STARTS, rng)
    done = np.zeros(len(F), dtype=bool)
    for _ in range(STEPS):
        left = np.flatnonzero(~done)
        if not len(left):
            break
        with np.errstate(over="ignore"):
            F[left], done[left], flat = _step(m, F[left])
        kicked = left[flat]
        moved = F[kicked] + 0.1 * rng.normal(size=(len(kicked), 3, 3))
        F[kicked] = np.where(inside(m, moved)[:, None, None], moved, F[kicked])
    s, E = svd(F)[1], m.expression.E
    still = done & inside(m, F) & _stable(m.eigensystem(F)[0], E) & (s[:, 0] < _FAR)
    away = ~still & ((np.abs(s[:, 2]) < 1e-3) | (s[:, 0] > _FAR))
    away &= m.energy(F) < -_FLAT * E if m.expression.has_energy else False
    stretches, hits = _distinct(s[still])
    return Minima(stretches, hits, len(F), int(away.sum()), int((~away & ~still).sum()))


def _starts(m: Material, n: int, rng: np.random.Generator) -> Array:
    """Return random F in the domain: half of size 1, the others down to 1/1000, one near 0."""
    F = rng.normal(size=(6 * n, 3, 3))
    F *= np.where(rng.random(6 * n) < 0.5, 1.0, 10 ** rng.uniform(-3, 0.3, 6 * n))[:, None, None]
    F = F[inside(m, F)][:n]
    if not m.expression.domain:  # the basin of a stable point may be as small as 1/2 - nu
        F[0] *= 1e-8
    return F


def _stable(values: Array, E: float) -> npt.NDArray[np.bool_]:
    """Return where eigenvalues (n, 9), in the order of the paper, are those of a minimum.

    Without stress a rotation needs no energy, so twist and flip eigenvalues may be 0.
    """
    return (values.min(axis=-1) > -_FLAT * E) & (values[:, :3].min(axis=-1) > _FLAT * E)


def _step(m: Material, F: Array) -> tuple[Array, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Take one step of Newton's method with the absolute Hessian and backtracking.

    Returns the next F and, for each, whether the descent has ended (at a minimum, or beyond `_FAR`)
    and whether F is stationary but no minimum.
    """
    E, (mu, lam) = m.expression.E, lame(m.expression.E, m.expression.nu)
    g = np.swapaxes(m.pk1(F), -1, -2).reshape(-1, 9)
    values, vectors = m.eigensystem(F)
    along = np.einsum("nij,ni->nj", vectors, g)
    # The gradient vanishes at a saddle point: perturb along the negative directions.
    along = np.where((values < -_FLAT * E) & (np.abs(along) < 1e-9 * E), 1e-7 * E, along)
    step = -np.einsum("nij,nj->ni", vectors, along / np.maximum(np.abs(values), _FLAT * E))
    length = np.linalg.norm(step, axis=-1, keepdims=True)
    reach = 0.5 * np.maximum(np.linalg.norm(F, axis=(-1, -2))[:, None], 0.1)
    step *= np.minimum(1, reach / np.maximum(length, 1e-300))
    step = np.swapaxes(step.reshape(-1, 3, 3), -1, -2)
    force = np.abs(g).max(axis=-1)
    calm = (force < 1e-8 * (E + mu + abs(lam))) & (values.min(axis=-1) > -_FLAT * E)
    # Close to an almost flat minimum the force is small long before the minimum is reached.
    stable = _stable(values, E)
    near = stable & (length[:, 0] < 1e-5)
    arrived = (calm & near) | (np.abs(F).max(axis=(-1, -2)) > 10 * _FAR)
    if not m.expression.has_energy:
        return np.where(arrived[:, None, None], F, F + 0.5 * step), arrived, calm & ~stable
    psi, t = m.energy(F), np.ones((len(F), 1, 1))
    for _ in range(30):
        worse = ~(m.energy(F + t * step) <= psi)
        if not worse.any():
            break
        t[worse] /= 3
    t[worse | arrived] = 0
    # No decrease is possible to rounding: the descent has converged.
    arrived |= worse & near & (force < 1e-5 * E)
    return F + t * step, arrived, calm & ~stable


def _distinct(s: Array) -> tuple[Array, tuple[int, ...]]:
    """Return distinct stretches, the rest state first, then by the number of hits."""
    found: list[Array] = []
    hits: list[int] = []
    for x in s:
        for k, y in enumerate(found):
            if np.abs(x - y).max() < _SAME:
                hits[k] += 1
                break
        else:
            found.append(x)
            hits.append(1)
    order = sorted(range(len(found)), key=lambda k: (np.abs(found[k] - 1).max() > _SAME, -hits[k]))
    stretches = np.array([found[k] for k in order]).reshape(-1, 3)
    return stretches, tuple(hits[k] for k in order)
