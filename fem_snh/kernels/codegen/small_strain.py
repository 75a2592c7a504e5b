r"""Generate the C functions of one energy at small strains, in terms of increments.

material_point.h calls these functions with increments of the measures from small_strain.h.

`Increments` splits an expression f of the measures as :math:`f = f_0 + df`. Here :math:`f_0` is the
value at rest, an expression of constants only, and df is the increment of f in terms of the
measures' increments (:math:`J - 1`, :math:`I_C - 3`, :math:`\sigma_i - 1`), which small_strain.h
computes to full relative accuracy. The values at rest cancel symbolically. Any cancellation left in
df is between terms of the size of the strain:

.. math::

    d(f + g) &= df + dg & d\log f &= \mathrm{log1p}(df/f_0) \\
    d(f g) &= f_0\,dg + df\,(g_0 + dg) & d\exp f &= \exp(f_0)\,\mathrm{expm1}(df) \\
    d(f^n) &= df\,(n f_0^{n-1} + df(\dots)) \\
    d(f^a) &= f_0^a\,\mathrm{expm1}(a\,\mathrm{log1p}(df/f_0))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce

import sympy
from sympy.codegen.cfunctions import expm1, log1p

from fem_snh.kernels.codegen.c_functions import Writer
from fem_snh.kernels.codegen.derivatives import I_C, II_C, J
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA, fractions, where

Pair = tuple[sympy.Expr, sympy.Expr]
_ZERO = sympy.Integer(0)


class Increments:
    """The map f -> (f0, df) of the module.

    Parameters
    ----------
    measures : mapping
        For each measure, its value at rest and the symbol of its increment.
    """

    def __init__(self, measures: Mapping[sympy.Symbol, Pair]) -> None:
        self._known: dict[sympy.Expr, Pair] = dict(measures)
        self._whole = {m: rest + change for m, (rest, change) in measures.items()}
        self._rest = {m: rest for m, (rest, _) in measures.items()}

    def __call__(self, expression: sympy.Expr) -> Pair:
        """Return (f0, df); f0 is simplified, so that an f0 that vanishes is 0."""
        at_rest, change = self._pair(fractions(sympy.sympify(expression)))
        return sympy.simplify(at_rest), change

    def _pair(self, f: sympy.Expr) -> Pair:
        if f not in self._known:
            self._known[f] = self._apply(f) if f.free_symbols & set(self._rest) else (f, _ZERO)
        return self._known[f]

    def _apply(self, f: sympy.Expr) -> Pair:
        """Return (f0, df) by the module's rules; df = f(x) - f(x at rest) for other functions."""
        pairs = [self._pair(a) for a in f.args]
        if f.is_Add:
            return sympy.Add(*(a for a, _ in pairs)), sympy.Add(*(d for _, d in pairs))
        if f.is_Mul:
            return reduce(_product, pairs)
        (f0, df), *rest = pairs
        nonzero = not sympy.simplify(f0).is_zero
        if f.is_Pow and f.exp.is_Integer and (f.exp > 0 or nonzero):
            power = _power(f0, df, abs(int(f.exp)))
            return power if f.exp > 0 else _inverse(*power)
        if f.is_Pow and nonzero and not f.exp.free_symbols & set(self._rest):
            return f0**f.exp, f0**f.exp * expm1(f.exp * log1p(df / f0))
        if isinstance(f, sympy.log) and nonzero:
            return sympy.log(f0), log1p(df / f0)
        if isinstance(f, log1p) and not sympy.simplify(1 + f0).is_zero:
            return sympy.log(1 + f0), log1p(df / (1 + f0))
        if isinstance(f, sympy.exp):
            return sympy.exp(f0), sympy.exp(f0) * expm1(df)
        if isinstance(f, where):
            # The condition depends on the measures alone, so its value at rest is a number.
            at_rest = rest[0 if f0.is_positive else 1][0]
            changes = [self._change(f, *p, at_rest) for f, p in zip(f.args[1:], rest, strict=True)]
            return at_rest, where(f0 + df, *changes)
        at_rest = f.subs(self._rest)
        return at_rest, f.subs(self._whole) - at_rest

    def _change(
        self, piece: sympy.Expr, f0: sympy.Expr, df: sympy.Expr, rest: sympy.Expr
    ) -> sympy.Expr:
        """Return ``piece - rest``: df + (f0 - rest), unless ``piece`` is singular at rest."""
        singular = (f0 + df).has(sympy.zoo, sympy.nan, sympy.oo)
        return piece.subs(self._whole) - rest if singular else df + (f0 - rest)


def _product(f: Pair, g: Pair) -> Pair:
    """Return (f0 g0, d(f g))."""
    (f0, df), (g0, dg) = f, g
    return f0 * g0, f0 * dg + df * (g0 + dg)


def _power(f0: sympy.Expr, df: sympy.Expr, n: int) -> Pair:
    """Return (f0^n, d(f^n)) by Horner's rule."""
    inner: sympy.Expr = _ZERO
    for k in range(n, 0, -1):
        inner = df * (sympy.binomial(n, k) * f0 ** (n - k) + inner)
    return f0**n, inner


def _inverse(f0: sympy.Expr, df: sympy.Expr) -> Pair:
    """Return (1/f0, d(1/f))."""
    return 1 / f0, -df / (f0 * (f0 + df))


#: Values at rest of the measures whose increments small_strain.h computes, in its order.
_INVARIANTS_AT_REST = {I_C: 3, II_C: 3, J: 1}
_STRETCHES_AT_REST = dict.fromkeys(SIGMA, 1)

#: The increment J - 1 of a cell's mean volume ratio.
VOLUME_INCREMENT = sympy.Symbol("change", real=True)
#: The small-strain form is used for |J - 1| below this value, where both forms are accurate to
#: double precision.
_SMALL_VOLUME_CHANGE = sympy.Rational(1, 4)


def small_strain_forms(curve: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Return expressions in J and VOLUME_INCREMENT that are accurate where J - 1 is small.

    Parameters
    ----------
    curve : sequence of sympy.Expr
        Expressions in J that the results equal.
    """
    increments = Increments({J: (sympy.Integer(1), VOLUME_INCREMENT)})
    small = _SMALL_VOLUME_CHANGE - sympy.Abs(VOLUME_INCREMENT)
    return [where(small, sympy.Add(*increments(f)), f) for f in curve]


class SmallStrainFunctions(Writer):
    """Generate the C functions of energy and stress at small strains.

    The arguments of the C functions are increments from rest: increments of the stretches for an
    energy that needs them, otherwise of the invariants. Every method returns C source.

    Parameters
    ----------
    energy : Energy
        A normalised energy.
    """

    def __init__(self, energy: Energy) -> None:
        super().__init__(energy)
        rest = _STRETCHES_AT_REST if energy.needs_stretches else _INVARIANTS_AT_REST
        self._change = {m: sympy.Symbol(f"change_{m}", real=True) for m in rest}
        self._split = Increments({m: (sympy.Integer(v), self._change[m]) for m, v in rest.items()})
        psi = energy.psi_sigma if energy.needs_stretches else energy.psi
        self._psi = None if psi is None else fractions(psi)

    def energy_function(self) -> str:
        """Return the function energy_small_strain; psi = 0 for a material without an energy."""
        psi: sympy.Expr = sum(0.0 * c for c in self._change.values())
        if self._psi is not None:
            psi = sympy.Add(*self._split(self._psi))
        return self._function("energy_small_strain", {"psi[0]": psi}, "psi", "INFINITY")

    def gradient_function(self) -> str:
        """Return the function gradient_small_strain of the principal stresses."""
        results = {f"g[{i}]": sympy.Add(*self._split(p)) for i, p in enumerate(self.energy.slopes)}
        return self._function("gradient_small_strain", results, "g", "0")

    def stress_function(self) -> str:
        """Return stress_factors_small_strain: P0, a, b, c of small_strain_stress in C."""
        (c, dc), (a, da), (j, dj) = (
            self._split(sympy.diff(self._psi, m)) for m in _INVARIANTS_AT_REST
        )
        factors = {
            # The values at rest are summed symbolically, where they cancel exactly.
            "factor[0]": sympy.simplify(2 * c + 4 * a + j) + (2 * dc + 4 * da + dj),
            "factor[1]": 2 * (c + dc),
            "factor[2]": 2 * (a + da),
            "factor[3]": j + dj,
        }
        return self._function("stress_factors_small_strain", factors, "factor", "0")

    def _function(
        self, name: str, results: Mapping[str, sympy.Expr], out: str, outside: str
    ) -> str:
        """Return a C function from increments to ``results``; see `Writer.write`."""
        lines = []
        for number, (m, change) in enumerate(self._change.items()):
            lines.append(f"  const real {change} = change[{number}];")
            rest = self._split(m)[0]
            lines.append(f"  const real {m} = {rest} + {change};")
        if self.energy.needs_stretches:
            lines.append(self.invariants())
        head = f"INLINE void {name}(Parameters p, const real *change, real *{out})"
        return self.write(head, lines, results, "n_", outside)
