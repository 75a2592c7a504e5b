"""The errors of the kernels at one F, and the bounds that rounding of F implies.

In double precision F has rounding errors, so the best possible result is the exact value at a
slightly different F. The bound of an error is the change of the exact value over perturbations of F
by ROUNDINGS roundings, plus as many roundings of the value. ROUNDINGS is one number for every
material, quantity, size and nu::

    bound(Q) = max_k |Q(F_k) - Q(F)| + r size(Q),   r = ROUNDINGS 2^-52
    size(energy) = the sum of the absolute values of its terms;
                   at small strain: |psi| + mu |F - I| + |lambda tr(F - I)|
    size(stress) = |P|,  size(Hessian) = |d2psi/dF2|      (Frobenius norms)

The perturbed F_k: every column of F changes by r times its length, in random directions and their
opposites (one-sided Jacobi is stable by columns, so a short column keeps its digits beside a long
one). At small strain, where no entry of F - I exceeds SMALL, F - I changes by r times its largest
entry: a rounding of F could exceed the strain.

Clamped and absolute Hessians have the exact Hessian's bound: the projection to a convex cone, and
the reflection about it, are nonexpansive in the Frobenius norm, so neither enlarges an error; nor
do eigenvalues, by Weyl's theorem. The smallest eigenvalue of a filtered Hessian is at least
-r |H|.

For two kinds of F the values are not compared; the test is only that every number is finite (an
energy may be +inf) and that Hessians are symmetric and semidefinite. At the first, F and F_k are on
different sides of the edge of the energy's domain. At the second, the Hessians of F_k differ from
that of F by half its norm or more: energies of tr S have a pole, and their stress a jump, where two
signed stretches sum to zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import mpmath
import numpy as np
from mpmath import mpf

from fem_snh.choices import EIGENSOLVERS
from fem_snh.kernels.material import Material
from fem_snh.studies.extremes.pointwise.oracle import Oracle, Point, exactly, norm

ROUNDINGS = 100
_R = ROUNDINGS * mpf(2) ** -52
#: Largest entry of F - I at which the strain counts as small.
SMALL = 0.1
#: Number of perturbed F_k for each F.
PERTURBATIONS = 4
#: Larger results may overflow in the kernels: the energy is then +inf, stress and Hessian are 0.
HUGE = mpf(10) ** 300


class Compared(NamedTuple):
    """One quantity at one F: its error, its bound, and its own size."""

    quantity: str
    error: Any
    bound: Any
    size: Any = mpf(0)

    @property
    def ratio(self) -> float:
        """Return the ratio of the error to the bound."""
        if self.error == 0:
            return 0.0
        return float(self.error / self.bound) if self.bound else float("inf")

    @property
    def has_digits(self) -> bool:
        """Return whether the bound is smaller than the quantity itself."""
        return bool(self.bound < self.size)


def digits(F: Any) -> int:
    """Return the working precision that leaves fifty digits of every result at F."""
    entries = np.abs(F[F != 0])
    spread = np.log10(entries.max() / entries.min()) if entries.size else 0
    return 60 + int(5 * min(spread, 24.0))


def is_small_strain(F: Any) -> bool:
    """Return whether no entry of F - I exceeds SMALL."""
    return bool(np.abs(F - np.eye(3)).max() <= SMALL)


def perturbed(F: Any, rng: np.random.Generator) -> Iterator[Any]:
    """Yield the perturbed F_k of the module docstring."""
    f = exactly(F)
    for _ in range(PERTURBATIONS // 2):
        r = exactly(rng.choice([-1.0, 1.0], (3, 3))) * _R
        if is_small_strain(F):
            r = r * max(map(abs, (f - exactly(np.eye(3))).ravel()))
        else:
            r = r * np.array([norm(f[:, j]) for j in range(3)], dtype=object)
        yield f + r
        yield f - r


def compare(m: Material, F: Any, rng: np.random.Generator) -> Iterator[Compared]:
    """Yield every quantity of the material at F, a (3, 3) array of doubles."""
    oracle = Oracle(m.expression)
    with mpmath.workdps(digits(F)):
        exact = oracle(exactly(F))
        near = [oracle(f) for f in perturbed(F, rng)]
        same = all(p.inside == exact.inside for p in near)
        if m.expression.has_energy:
            yield _energy(m, F, exact, near, same)
        true = exact.hessian() if exact.blocks is not None else None
        change = _change([p.hessian() if p.blocks is not None else None for p in near], true)
        decided = same and (not exact.inside or (true is not None and 2 * change < norm(true)))
        bound = _change([p.P for p in near], exact.P)
        yield _array("pk1", m.pk1(F), exact, exact.P, bound, decided)
        yield _array("hessian exact", m.hessian(F), exact, true, change, decided)
        yield from _filters(m, F, exact, change, decided)


def _change(near: list[Any], exact: Any) -> Any:
    """Return max_k |Q_k - Q|; inf if one is missing."""
    if exact is None or any(q is None for q in near):
        return mpmath.inf
    return max(norm(np.asarray(q - exact)) for q in near)


def _energy(m: Material, F: Any, exact: Point, near: list[Point], same: bool) -> Compared:
    """Compare the energy; ``same`` if F and all F_k are on one side of the domain's edge."""
    found = float(m.energy(F))
    if np.isnan(found):
        return Compared("energy", mpmath.inf, mpf(0))
    if not exact.inside or not same:
        wrong = same and found != np.inf
        return Compared("energy", mpmath.inf if wrong else mpf(0), mpf(0))
    if abs(exact.energy) > HUGE and not abs(found) < np.inf:
        return Compared("energy", mpf(0), mpf(0))
    size = exact.terms
    if is_small_strain(F):
        mu, lam = map(mpf, m.expression.lame)
        H = exactly(F - np.eye(3))  # exact: the entries are near 1
        size = abs(exact.energy) + mu * norm(H) + abs(lam * np.trace(H))
        size += abs(mpf(m.expression.rest_stress)) * norm(H)
    bound = max(abs(p.energy - exact.energy) for p in near) + _R * size
    return Compared("energy", abs(mpf(found) - exact.energy), bound, abs(exact.energy))


def _array(what: str, found: Any, at: Point, exact: Any, change: Any, decided: bool) -> Compared:
    """Compare a stress or Hessian: zero outside the domain, within the bound inside."""
    if not np.isfinite(found).all():
        return Compared(what, mpmath.inf, mpf(0))
    if decided and not at.inside:
        return Compared(what, mpmath.inf if found.any() else mpf(0), mpf(0))
    if not decided or exact is None or (norm(exact) > HUGE and not found.any()):
        return Compared(what, mpf(0), mpf(0))
    return Compared(what, norm(exactly(found) - exact), change + _R * norm(exact), norm(exact))


def _filters(m: Material, F: Any, at: Point, change: Any, decided: bool) -> Iterator[Compared]:
    """Compare the filtered Hessians and the eigenvalues, by both eigensolvers."""
    filters = ("clamp", "abs")
    known = at.blocks is not None
    true = {filter: at.hessian(filter) if known else None for filter in filters}
    eigenvalues = np.array(at.eigenvalues, dtype=object) if known else None
    for solver in EIGENSOLVERS:
        for filter in filters:
            found, what = m.hessian(F, filter, solver), f"hessian {filter}, {solver}"
            yield _array(what, found, at, true[filter], change, decided)
            if not np.array_equal(found, found.T):
                yield Compared(what, mpmath.inf, mpf(0))
            lowest = np.linalg.eigvalsh(found / (float(norm(found)) or 1.0))[0]
            yield Compared(f"lowest {filter}, {solver}", mpf(max(0.0, -lowest)), _R, mpf(1))
        values = np.sort(m.eigensystem(F, solver)[0])
        yield _array(f"eigenvalues, {solver}", values, at, eigenvalues, change, decided)
