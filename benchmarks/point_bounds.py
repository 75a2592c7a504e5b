"""Bounds of the errors of a material's kernels at extreme stretches, by exact values in 50 digits.

The kernels at F = diag(s) are compared with the material's expression, which sympy differentiates
and mpmath evaluates at the exact values of the doubles. In double precision F has rounding errors,
so the best possible result is the exact value at a slightly different F. The bound of an error is
the change of the exact value over perturbations of F by ROUNDINGS roundings, plus as many roundings
of the value. ROUNDINGS is one number for every material, quantity, size and nu::

    bound(Q) = max_k |Q(F_k) - Q(F)| + r size(Q),   r = ROUNDINGS 2^-52
    size(energy) = the sum of the absolute values of its terms, those in log1p included;
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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import mpmath
import numpy as np
import numpy.typing as npt
import sympy
from mpmath import mpf
from sympy.codegen.cfunctions import log1p

from fem_snh.choices import EIGENSOLVERS
from fem_snh.kernels.material import Material
from fem_snh.kernels.material import material as make_material
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import INVARIANTS, SIGMA, fractions

Array = npt.NDArray[np.float64]


#: Pairs (nu, E [Pa]), each combined with each group of stretches.
MODULI = (
    (-0.9, 1e-6), (-0.5, 1e3), (0.0, 1.0), (0.3, 1e12),
    (0.45, 1e-6), (0.49, 1.7), (0.4999, 1e6), (0.4999999, 1.0),
)  # fmt: skip
QUICK = ((-0.9, 1e12), (0.4999999, 1e-6))
_NEAR = (1e-4, 1e-6, 1e-8, 1e-12, 1e-16)
#: The groups of `stretches`.
STRETCHED = (
    "regular", "1e-12..1e12", "1e-12..1e12 signed", "equal", "equal signed",
    *(f"near-equal {d:g}" for d in _NEAR), *(f"pair {d:g}" for d in _NEAR),
    "mirrored 0", "mirrored 1e-4", "mirrored 1e-9", "zero 1", "zero 2", "zero 3",
    "negative 1", "negative 2", "negative 3",
)  # fmt: skip
STRAINED = tuple(f"strain {e:g}" for e in (1e-4, 1e-6, 1e-9, 1e-12, 1e-15))

ROUNDINGS = 100
_R = ROUNDINGS * mpf(2) ** -52
#: Largest entry of F - I at which the strain counts as small.
SMALL = 0.1
#: Number of perturbed F_k for each F.
PERTURBATIONS = 4
#: Larger results may overflow in the kernels: the energy is then +inf, stress and Hessian are 0.
HUGE = mpf(10) ** 300
#: (i, j, k): twist and flip i couple the stretches j and k (Smith et al. 2018, eq. 46-48).
PAIRS = ((0, 1, 2), (1, 0, 2), (2, 0, 1))


def stretches(name: str, rng: np.random.Generator) -> Array:
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
        case "strain":
            return 1 + float(rest) * rng.uniform(-1, 1, 3)
    raise ValueError(name)


def exactly(F: Any) -> Any:
    """Return an array of doubles as mpmath numbers."""
    return np.vectorize(mpf, otypes=[object])(np.asarray(F, dtype=object))


def norm(A: Any) -> Any:
    """Return the Frobenius norm."""
    return mpmath.sqrt(mpmath.fsum(x * x for x in np.ravel(A)))


def filtered(A: Any, filter: str) -> Any:
    """Return a symmetric matrix with its eigenvalues clamped or made positive."""
    values, Q = mpmath.eigsy(mpmath.matrix(A.tolist()))
    Q = np.array(Q.tolist(), dtype=object).reshape(A.shape)
    return (Q * np.array(_each(values, filter), dtype=object)) @ Q.T


def _each(values: Any, filter: str) -> list[Any]:
    return [max(v, mpf(0)) if filter == "clamp" else abs(v) for v in values]


@dataclass
class Exact:
    """Energy, stress and Hessian of a material at F = diag(s), as mpmath numbers.

    Outside the energy's domain the stress and ``blocks`` are None, which are those of the Hessian:
    scaling (3, 3), twist, flip.
    """

    energy: Any = mpmath.inf  # None without an energy
    terms: Any = 0  # the sum of the absolute values of the energy's terms
    P: Any = None
    blocks: Any = None

    @property
    def inside(self) -> bool:
        """Whether F is in the domain of the energy."""
        return self.blocks is not None

    @property
    def eigenvalues(self) -> Any:
        """Return all nine eigenvalues of the Hessian, ascending."""
        A, twist, flip = self.blocks
        scaling = mpmath.eigsy(mpmath.matrix(A.tolist()), eigvals_only=True)
        return np.array(sorted([*scaling, *twist, *flip]), dtype=object)

    def hessian(self, filter: str = "exact") -> Any:
        """Return d2psi/dF2 (9, 9) after the filter."""
        A, twist, flip = self.blocks
        if filter != "exact":
            A, twist, flip = filtered(A, filter), *(_each(x, filter) for x in (twist, flip))
        H = np.full((9, 9), mpf(0), dtype=object)
        H[::4, ::4] = A
        for i, j, k in PAIRS:
            a, b = 3 * k + j, 3 * j + k
            H[a, a] = H[b, b] = (flip[i] + twist[i]) / 2
            H[a, b] = H[b, a] = (flip[i] - twist[i]) / 2
        return H


@lru_cache(maxsize=8)
def _functions(psi: Any, slopes: Any, domain: Any, constants: Any) -> list[Callable[..., Any]]:
    """Return functions for the domain, the energy and the size of its terms, and derivatives."""

    def size(f: sympy.Expr) -> sympy.Expr:
        """Return the sum of the absolute values of the terms of f."""
        if f.is_Add:
            return sympy.Add(*map(size, f.args))
        if isinstance(f, log1p):  # the terms of its argument, which it does not change near 0
            return sympy.Abs(f) + size(f.args[0]) / sympy.Abs(1 + f.args[0])
        return sympy.Mul(*map(size, f.args)) if f.is_Mul else sympy.Abs(f)

    psi = sympy.Integer(0) if psi is None else fractions(psi)
    slopes = [fractions(p) for p in slopes]
    second = [[sympy.diff(p, s) for s in SIGMA] for p in slopes]
    results = ([d.subs(INVARIANTS) for d in domain], [psi, size(psi)], [slopes, second])
    return [sympy.lambdify((*SIGMA, *constants), e, "mpmath") for e in results]


def evaluate(energy: Energy, s: Any) -> Exact:
    """Evaluate an energy at stretches (3,), mpmath numbers, in the working precision of mpmath."""
    domain, psi, derivatives = _functions(
        energy.psi_sigma, energy.slopes, energy.domain, energy.constants
    )
    constants = [mpf(v) for v in energy.values]
    try:
        limits = domain(*s, *constants)
    except ZeroDivisionError:  # J = 0
        limits = [mpf(0)]
    if any(mpmath.im(d) != 0 or d <= 0 for d in limits):
        return Exact(mpmath.inf if energy.has_energy else None)
    value, terms = map(mpf, psi(*s, *constants))
    p, A = map(exactly, derivatives(*s, *constants))
    A = (A + A.T) / 2  # of a stress that is no gradient: the symmetric part
    equal = mpf(10) ** (-mpmath.mp.dps // 3)

    def quotient(j: int, k: int, sign: int) -> Any:
        """Return (p_j + sign p_k)/(s_j + sign s_k), its limit, or inf at a pole."""
        sums = s[j] + sign * s[k], p[j] + sign * p[k]
        if abs(sums[0]) > equal * (abs(s[j]) + abs(s[k])):
            return sums[1] / sums[0]
        smooth = abs(sums[1]) <= equal * (abs(p[j]) + abs(p[k]))
        return (A[j, j] + A[k, k]) / 2 + sign * A[j, k] if smooth else mpmath.inf

    twist, flip = ([quotient(j, k, sign) for _, j, k in PAIRS] for sign in (1, -1))
    return Exact(value if energy.has_energy else None, terms, np.diag(p), (A, twist, flip))


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
    """Return the working precision that leaves fifty digits of every result at F, or stretches."""
    entries = np.abs(F[F != 0])
    spread = np.log10(entries.max() / entries.min()) if entries.size else 0
    return 60 + int(5 * min(spread, 24.0))


def _strain(F: Any) -> Any:
    """Return F - I, or stretches - 1: exact, if the entries are near 1."""
    return F - (np.eye(3) if np.ndim(F) == 2 else np.ones(3))


def is_small_strain(F: Any) -> bool:
    """Return whether no entry of F - I exceeds SMALL."""
    return bool(np.abs(_strain(F)).max() <= SMALL)


def perturbed(F: Any, rng: np.random.Generator) -> Iterator[Any]:
    """Yield F, (3, 3) or the stretches (3,) of a diagonal one, and the F_k of the module's text."""
    f = exactly(F)
    yield f
    for k in range(PERTURBATIONS // 2):
        # Of stretches any two change in opposite directions at least once: near a pole it matters.
        signs = np.roll([1.0, 1.0, -1.0], k) if F.ndim == 1 else rng.choice([-1.0, 1.0], F.shape)
        r = exactly(signs) * _R
        if is_small_strain(F):
            r = r * max(map(abs, exactly(_strain(F)).ravel()))
        else:
            r = r * np.array([norm(column) for column in f.T], dtype=object)
        yield f + r
        yield f - r


def compare(
    m: Material, F: Any, points: Sequence[Any], eigensolvers: Sequence[str] = EIGENSOLVERS[:1]
) -> Iterator[Compared]:
    """Yield every quantity of the material at F, (3, 3) doubles.

    ``points`` has the exact values at F and at the F_k: `Exact`, or another class with its names.
    """
    at, *near = points
    same = all(p.inside == at.inside for p in near)

    def compared(
        what: str, found: Any, exact: Any, change: Any, known: bool, size: Any = None
    ) -> Compared:
        """Compare an array; outside the domain an energy is +inf, and the others are 0."""
        outside = bool((found == (np.inf if what == "energy" else 0)).all())
        wrong = Compared(what, mpmath.inf, mpf(0))
        if not (np.isfinite(found).all() or outside):
            return wrong
        if known and not at.inside:
            return Compared(what, mpf(0), mpf(0)) if outside else wrong
        if not known or (outside and norm(exact) > HUGE):
            return Compared(what, mpf(0), mpf(0))
        size = norm(exact) if size is None else size
        return Compared(what, norm(exactly(found) - exact), change + _R * size, norm(exact))

    def largest(change: Callable[[Any], Any]) -> Any:
        """Return max_k |Q_k - Q|; 0 where the values are not compared."""
        return max(norm(change(p) - change(at)) for p in near) if at.inside and same else mpf(0)

    if m.has_energy:
        size = at.terms
        if is_small_strain(F):
            mu, lam = map(mpf, m.expression.lame)
            H = exactly(_strain(F))
            size = abs(at.energy) + mu * norm(H) + abs(lam * np.trace(H))
            size += abs(mpf(m.expression.rest_stress)) * norm(H)
        moved = largest(lambda p: np.array(p.energy))
        yield compared("energy", m.energy(F), np.array(at.energy), moved, same, size)
    true = {f: at.hessian(f) if at.inside else None for f in ("exact", "clamp", "abs")}
    change = largest(lambda p: p.hessian())
    known = same and (not at.inside or bool(2 * change < norm(true["exact"])))
    yield compared("pk1", m.pk1(F), at.P, largest(lambda p: p.P), known)
    yield compared("hessian exact", m.hessian(F), true["exact"], change, known)
    for solver in eigensolvers:
        for filter in ("clamp", "abs"):
            H, what = m.hessian(F, filter, solver), f"hessian {filter}, {solver}"
            yield compared(what, H, true[filter], change, known)
            if not np.array_equal(H, H.T):
                yield Compared(what, mpmath.inf, mpf(0))
            lowest = np.linalg.eigvalsh(H / (float(norm(H)) or 1.0))[0]
            yield Compared(f"lowest {filter}, {solver}", mpf(max(0.0, -lowest)), _R, mpf(1))
        values = np.sort(m.eigensystem(F, solver)[0])
        exact = at.eigenvalues if at.inside else None
        yield compared(f"eigenvalues, {solver}", values, exact, change, known)


def measure(
    material: str,
    quick: bool = False,
    *,
    samples: Callable[[Material, int], Iterator[tuple[str, Any, Any]]],
    eigensolvers: Sequence[str],
) -> Iterator[dict[str, Any]]:
    """Compare a material at the F that ``samples`` yields for it and a number.

    ``quick`` takes two (nu, E), and each group of points at one of them, in turns; the parity of
    the name's length decides with which they begin, so that all materials together meet every pair.

    Yields
    ------
    dict
        A row for each (nu, E), group of points and quantity: ``ratio`` of the error to its bound,
        ``passed`` if that is at most 1, ``digits``, whether the bound is smaller than the quantity.
    """
    for number, (nu, E) in enumerate(QUICK if quick else MODULI):
        m = make_material(material, E=E, nu=nu)
        for turn, (group, F, points) in enumerate(samples(m, number), len(material) + number):
            if quick and turn % 2:
                continue
            with mpmath.workdps(digits(F)):
                for c in compare(m, F, points, eigensolvers):
                    yield {
                        "material": material, "nu": nu, "E": E, "group": group,
                        "quantity": c.quantity, "digits": c.has_digits,
                        "error": float(c.error), "bound": float(c.bound), "ratio": c.ratio,
                        "passed": c.ratio <= 1, "F": " ".join(x.hex() for x in F.ravel()),
                    }  # fmt: skip
