"""All the shapes an element may come to rest in: descent from many deformation gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_snh.kernels.pointwise import Material, svd
from fem_snh.reports.probe import Array, has_energy, inside

STEPS = 150  # of the descent, at most
_SAME = 1e-3  # stretches that differ by less are one minimum


@dataclass(frozen=True)
class Minima:
    """Local minima of psi over all F.

    stretches : their signed principal stretches (n, 3); rest, if it is one, first.

    hits : how many starts ended in each.
    starts : how many there were.
    collapsed, lost : how many fell below the energy of rest, towards a stretch of zero or without
        end; and how many had not arrived anywhere when the descent stopped.
    """

    stretches: Array
    hits: tuple[int, ...]
    starts: int
    collapsed: int
    lost: int

    @property
    def rest(self) -> bool:
        """Whether rest is one of them."""
        return bool(len(self.stretches)) and bool(np.allclose(self.stretches[0], 1, atol=_SAME))

    @property
    def spurious(self) -> Array:
        """Those that are not rest."""
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
        if self.lost > self.starts // 50:
            found += f"; {self.lost} of {self.starts} starts lost"
        return found


def minima(m: Material, starts: int = 160, seed: int = 0) -> Minima:
    """Descend from ``starts`` random F of every size and orientation, inverted ones too.

    Only minima in all nine directions count: the Hessian there has no negative eigenvalue.
    """
    F = _starts(m, starts, seed)
    scale = m.law.E
    done = np.zeros(len(F), dtype=bool)
    for _ in range(STEPS):
        left = np.flatnonzero(~done)
        if not len(left):
            break
        with np.errstate(over="ignore"):
            F[left], done[left] = _step(m, F[left])
    values = m.eigensystem(F)[0].min(axis=-1)
    s = svd(F)[1]
    away = (np.abs(s[:, 2]) < 1e-3) | (s[:, 0] > 1e3)
    if has_energy(m):
        away &= m.energy(F) < -1e-6 * scale
    still = done & inside(m, F) & (values > -1e-6 * scale) & (s[:, 0] < 1e3)
    stretches, hits = _distinct(s[still])
    return Minima(stretches, hits, len(F), int((away & ~still).sum()), int((~away & ~still).sum()))


def _starts(m: Material, n: int, seed: int) -> Array:
    """Random F, half of them near 1 in size, the others down to 1/1000; inside the domain."""
    rng = np.random.default_rng(seed)
    F = rng.normal(size=(6 * n, 3, 3))
    F *= np.where(rng.random(6 * n) < 0.5, 1.0, 10 ** rng.uniform(-3, 0.3, 6 * n))[:, None, None]
    return F[inside(m, F)][:n]


def _step(m: Material, F: Array) -> tuple[Array, Array]:
    """One step of Newton's method on |Hessian|, with backtracking: the next F, and who is done."""
    E = m.law.E
    P = m.pk1(F)
    g = np.swapaxes(P, -1, -2).reshape(-1, 9)
    values, vectors = m.eigensystem(F)
    size = np.abs(values)
    along = np.einsum("nij,ni->nj", vectors, g)
    # A saddle has no slope to leave by: a little push along its negative directions.
    along = np.where((values < -1e-6 * E) & (np.abs(along) < 1e-9 * E), 1e-7 * E, along)
    step = -np.einsum("nij,nj->ni", vectors, along / np.maximum(size, 1e-6 * E))
    length = np.linalg.norm(step, axis=-1, keepdims=True)
    reach = 0.5 * np.maximum(np.linalg.norm(F, axis=(-1, -2))[:, None], 0.1)
    step *= np.minimum(1, reach / np.maximum(length, 1e-300))
    step = np.swapaxes(step.reshape(-1, 3, 3), -1, -2)
    mu, lam = m.lame
    done = (np.abs(g).max(axis=-1) < 1e-8 * (E + mu + abs(lam))) & (values.min(axis=-1) > -1e-6 * E)
    done |= np.abs(F).max(axis=(-1, -2)) > 1e4
    if not has_energy(m):
        return np.where(done[:, None, None], F, F + 0.5 * step), done
    psi, t = m.energy(F), np.ones((len(F), 1, 1))
    for _ in range(30):
        worse = ~(m.energy(F + t * step) <= psi)
        if not worse.any():
            break
        t[worse] /= 3
    t[worse | done] = 0
    # Nowhere lower, to rounding: it is at rest.
    stuck = worse & (np.abs(g).max(axis=-1) < 1e-5 * E) & (values.min(axis=-1) > -1e-6 * E)
    return F + t * step, done | stuck


def _distinct(s: Array) -> tuple[Array, tuple[int, ...]]:
    """Stretches without repetitions, rest first, then by how often they were found."""
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
