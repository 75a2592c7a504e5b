r"""First and second derivatives of an energy, and the blocks of its Hessian in closed form.

Smith et al. 2018, eq. 42-48, give the eigensystem for energies of :math:`I_C` and :math:`J`. The
same structure holds for every isotropic energy
(with :math:`\psi_j = \partial\psi/\partial\sigma_j`):

.. math::

    A_{ij} &= \partial^2\psi / \partial\sigma_i \partial\sigma_j
        && \text{scaling block} \\
    \lambda^\mathrm{twist}_i &= (\psi_j + \psi_k) / (\sigma_j + \sigma_k)
        && \text{antisymmetric eigenmatrix } D_{3+i} \\
    \lambda^\mathrm{flip}_i &= (\psi_j - \psi_k) / (\sigma_j - \sigma_k)
        && \text{symmetric eigenmatrix } D_{6+i}

For an energy of the invariants the divisions cancel, except the division by
:math:`\sigma_j + \sigma_k` for :math:`I_1 = \mathrm{tr}\,S` (here :math:`\psi_m` is the derivative
in invariant m):

.. math::

    \lambda^\mathrm{twist}_i &= 2\psi_1/(\sigma_j + \sigma_k) + 2\psi_C
        + 2\psi_{II}\,(I_C - \sigma_j^2 + \sigma_j\sigma_k - \sigma_k^2) + \sigma_i\psi_J \\
    \lambda^\mathrm{flip}_i &= 2\psi_C
        + 2\psi_{II}\,(I_C - \sigma_j^2 - \sigma_j\sigma_k - \sigma_k^2) - \sigma_i\psi_J

`DividedDifference` avoids cancellation in these quotients. Where :math:`\sigma_j` and
:math:`\sigma_k` are nearly equal,
:math:`(\psi_j - \psi_k)/(\sigma_j - \sigma_k)` loses as many digits as the two stretches share.
:math:`\psi_k` is :math:`\psi_j` with the two stretches exchanged. Let f' be an expression f with
the stretches exchanged. The divided difference :math:`[f] = (f - f')/(\sigma_j - \sigma_k)` follows
from the divided differences of the operands of f:

.. math::

    [\sigma_j] &= 1, \quad [\sigma_k] = -1 \\
    [f + g] &= [f] + [g], \quad [f g] = [f]\, g + f'\,[g] \\
    [f^n] &= [f] \sum_{m<n} f^m f'^{\,n-1-m} \\
    [\log f] &= [f]/f' \; \mathrm{log1p\_over\_x}(d/f') \\
    [f^a] &= [f]\, f'^{\,a-1}\, \mathrm{powm1\_over\_x}(d/f', a) \\
    [\exp f] &= [f] \exp(f')\, \mathrm{expm1\_over\_x}(d)

with :math:`d = f - f' = [f](\sigma_j - \sigma_k)`; log_exp_series.h has the three functions,
:math:`\mathrm{log1p\_over\_x}(x) = \log(1 + x)/x` and so on.

For :math:`(\psi_j + \psi_k)/(\sigma_j + \sigma_k)`, where an inverted :math:`\sigma_k` is close
to :math:`-\sigma_j`, f' has the stretches exchanged and their signs changed. This does not change
the value of an energy that is smooth there.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from random import Random

import mpmath
import sympy
from sympy.codegen.cfunctions import log1p

from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import INVARIANTS, SIGMA, where

expm1_over_x, log1p_over_x = sympy.Function("expm1_over_x"), sympy.Function("log1p_over_x")


class powm1_over_x(sympy.Function):
    """The function ((1 + x)^a - 1)/x."""

    nargs = (2,)


class DividedDifference:
    """The map f -> [f] of the module, for the stretches x and y.

    Parameters
    ----------
    x, y : sympy.Symbol
        The stretches.
    sign : int
        1 for (f - f')/(x - y); -1 for (f - f')/(x + y), where f' has x and y exchanged and their
        signs changed.
    """

    def __init__(self, x: sympy.Symbol, y: sympy.Symbol, sign: int = 1) -> None:
        self._exchange = {x: sign * y, y: sign * x}
        self._difference = x - sign * y
        self._known = {x: sympy.Integer(1), y: sympy.Integer(-sign)}

    def exchange(self, f: sympy.Expr) -> sympy.Expr:
        """Return f': f with the stretches exchanged (and their signs changed if ``sign`` is -1)."""
        return f.xreplace(self._exchange)

    def __call__(self, f: sympy.Expr) -> sympy.Expr:
        """Return the divided difference [f]."""
        if f not in self._known:
            constant = not f.free_symbols & set(self._exchange)
            self._known[f] = sympy.Integer(0) if constant else self._apply(f)
        return self._known[f]

    def _apply(self, f: sympy.Expr) -> sympy.Expr:
        """Return [f] by the module's rules; the plain quotient for any other function."""
        if f.is_Add:
            return sympy.Add(*map(self, f.args))
        if f.is_Mul:
            head, tail = f.as_two_terms()
            return self(head) * tail + self.exchange(head) * self(tail)
        if isinstance(f, where):
            condition, a, b = f.args
            apart = (f - self.exchange(f)) / self._difference  # the stretches in different pieces
            other = self.exchange(condition)
            return where(condition, where(other, self(a), apart), where(other, apart, self(b)))
        inner = f.args[0]
        divided, exchanged = self(inner), self.exchange(inner)
        if divided == 0:
            return sympy.Integer(0)
        d = divided * self._difference
        if f.is_Pow and f.exp.is_Integer:
            n = abs(int(f.exp))
            total = divided * sum(inner**m * exchanged ** (n - 1 - m) for m in range(n))
            return total if f.exp > 0 else -total / (inner * exchanged) ** n
        if f.is_Pow and not f.exp.free_symbols & set(self._exchange):
            return divided * exchanged ** (f.exp - 1) * powm1_over_x(d / exchanged, f.exp)
        if isinstance(f, sympy.log):
            return divided / exchanged * log1p_over_x(d / exchanged)
        if isinstance(f, log1p):
            return divided / (1 + exchanged) * log1p_over_x(d / (1 + exchanged))
        if isinstance(f, sympy.exp):
            return divided * sympy.exp(exchanged) * expm1_over_x(d)
        return (f - self.exchange(f)) / self._difference


I1, I_C, II_C, J = INVARIANTS
#: `_is_zero` evaluates an expression at _POINTS random points with _DIGITS digits. A value below
#: _ZERO counts as 0: far above 50-digit rounding, far below the terms of an energy.
_POINTS, _DIGITS, _ZERO = 16, 50, 1e-30
#: Largest power in a simplified derivative: J^9 overflows where the stretches are 1e12.
_LARGEST_POWER = 8


class Derivatives:
    """First and second derivatives of psi in its measures (invariants or stretches), as symbols.

    Derivatives that vanish identically have no symbol.

    Attributes
    ----------
    first : dict
        Symbol of dpsi/dm by measure m.
    second : dict
        Symbol of d2psi/dm dn by measures (m, n), in the order of the energy's ``measures``.
    derivatives : dict
        Expression of each symbol.
    """

    def __init__(self, energy: Energy) -> None:
        self.energy = energy
        self.first: dict[sympy.Symbol, sympy.Symbol] = {}
        self.second: dict[tuple[sympy.Symbol, sympy.Symbol], sympy.Symbol] = {}
        self.derivatives: dict[sympy.Symbol, sympy.Expr] = {}
        if energy.of_stretches:
            stresses = dict(zip(SIGMA, energy.slopes, strict=True))
            for s in SIGMA:
                self._add(self.first, s, f"psi_{s}", stresses[s])
            for s, t in combinations_with_replacement(SIGMA, 2):
                # Without an energy the derivative is unsymmetric: take its symmetric part.
                derivative = sympy.diff(stresses[s], t)
                if not energy.has_energy:
                    derivative = (derivative + sympy.diff(stresses[t], s)) / 2
                self._add(self.second, (s, t), f"psi_{s}_{t}", derivative)
            return
        for m in energy.measures:
            self._add(self.first, m, f"psi_{m}", _simplified(sympy.diff(energy.psi, m)))
        for m, n in combinations_with_replacement(energy.measures, 2):
            second = _simplified(sympy.diff(energy.psi, m, n))
            self._add(self.second, (m, n), f"psi_{m}_{n}", second)

    def _add(self, table: dict, key: object, name: str, expression: sympy.Expr) -> None:
        if expression != 0:
            table[key] = sympy.Symbol(name)
            self.derivatives[table[key]] = expression

    def derivative(self, *measures: sympy.Symbol) -> sympy.Expr:
        """Return the symbol of psi's derivative in one or two measures, or 0 if it vanishes."""
        if len(measures) == 1:
            return self.first.get(measures[0], sympy.Integer(0))
        m, n = sorted(measures, key=self.energy.measures.index)
        return self.second.get((m, n), sympy.Integer(0))

    def principal_stress(self, s: sympy.Symbol) -> sympy.Expr:
        """Return dpsi/ds by the chain rule over the measures."""
        if self.energy.of_stretches:
            return self.derivative(s)
        return sum(self.derivative(m) * sympy.diff(INVARIANTS[m], s) for m in self.energy.measures)

    def second_derivative(self, s: sympy.Symbol, t: sympy.Symbol) -> sympy.Expr:
        """Return d2psi/ds dt by the chain rule over the measures."""
        if self.energy.of_stretches:
            return self.derivative(s, t)
        measures = self.energy.measures
        total = sum(self.derivative(m) * sympy.diff(INVARIANTS[m], s, t) for m in measures)
        for m in measures:
            for n in measures:
                ds, dt = sympy.diff(INVARIANTS[m], s), sympy.diff(INVARIANTS[n], t)
                total += self.derivative(m, n) * ds * dt
        return sympy.sympify(total)

    def twist_and_flip(
        self, si: sympy.Symbol, sj: sympy.Symbol, sk: sympy.Symbol
    ) -> tuple[sympy.Expr, sympy.Expr]:
        """Return the eigenvalues (twist_i, flip_i) by the module's equations."""
        if self.energy.of_stretches:
            return self._twist(sj, sk), self._flip(sj, sk)
        common = 2 * self.derivative(I_C)
        area = 2 * self.derivative(II_C)
        total = sum(s**2 for s in SIGMA)
        twist = common + area * (total - (sj**2 - sj * sk + sk**2)) + si * self.derivative(J)
        flip = common + area * (total - (sj**2 + sj * sk + sk**2)) - si * self.derivative(J)
        if self.derivative(I1) != 0:
            twist += 2 * self.derivative(I1) * sympy.Function("inverse_sum")(sj, sk)
        return twist, flip

    def _flip(self, sj: sympy.Symbol, sk: sympy.Symbol) -> sympy.Expr:
        """Return (psi_j - psi_k)/(s_j - s_k) as a C quotient without cancellation."""
        stress = self.derivatives.get(self.principal_stress(sj), sympy.Integer(0))
        difference = self.principal_stress(sj) - self.principal_stress(sk)
        divided = DividedDifference(sj, sk)(stress)
        return sympy.Function("quotient")(difference, sj - sk, sj + sk, divided)

    def _twist(self, sj: sympy.Symbol, sk: sympy.Symbol) -> sympy.Expr:
        """Return (psi_j + psi_k)/(s_j + s_k), whose denominator vanishes only if inverted."""
        total = self.principal_stress(sj) + self.principal_stress(sk)
        stress_j = self.derivatives.get(self.principal_stress(sj), sympy.Integer(0))
        stress_k = self.derivatives.get(self.principal_stress(sk), sympy.Integer(0))
        divided = DividedDifference(sj, sk, sign=-1)
        # Where psi_k(s_j, s_k) = -psi_j(-s_k, -s_j), the quotient has a limit at s_j + s_k = 0.
        if self.energy.inversion_safe and _is_zero(divided.exchange(stress_j) + stress_k):
            return sympy.Function("quotient")(total, sj + sk, sj - sk, divided(stress_j))
        return total * sympy.Function("inverse_sum")(sj, sk)


def _simplified(expression: sympy.Expr) -> sympy.Expr:
    """Return a simpler form of the expression, with every `where` left as it is written.

    In a `where`, sympy would expand small differences such as I_C - 3 and lose their digits. If the
    simpler form has a power that may overflow, such as J^10, the expression is returned unchanged.
    """
    pieces = {w: sympy.Dummy(real=True) for w in expression.atoms(where)}
    simpler = sympy.simplify(expression.xreplace(pieces))
    powers = (p.exp for p in simpler.atoms(sympy.Pow) if p.exp.is_Number)
    if max(map(abs, powers), default=0) > _LARGEST_POWER:
        return expression
    return simpler.xreplace({dummy: w for w, dummy in pieces.items()})


def _is_zero(expression: sympy.Expr) -> bool:
    """Return whether an expression vanishes at `_POINTS` random points.

    A proof by sympy.simplify takes minutes for piecewise energies.
    """
    symbols, random = sorted(expression.free_symbols, key=str), Random(0)
    value = sympy.lambdify(symbols, expression, "mpmath")
    with mpmath.workdps(_DIGITS):
        for _ in range(_POINTS):
            point = [mpmath.mpf(random.uniform(0.1, 2)) for _ in symbols]
            signs = [random.choice((-1, 1)) if s in SIGMA else 1 for s in symbols]
            if abs(value(*(x * sign for x, sign in zip(point, signs, strict=True)))) > _ZERO:
                return False
    return True
