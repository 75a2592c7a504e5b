"""First and second derivatives of an energy as named symbols, and the Hessian's blocks from them.

The closed forms (paper, eq. 42-48 for I_C and J; here for every isotropic energy):

scaling block   A_ij = d2psi/ds_i ds_j
twist_i         (psi_j + psi_k) / (s_j + s_k)      antisymmetric eigenmatrix D_3+i
flip_i          (psi_j - psi_k) / (s_j - s_k)      symmetric eigenmatrix D_6+i

An energy of the invariants needs no such division (psi_m = dpsi/dI_m):

twist_i = 2 psi_1/(s_j + s_k) + 2 psi_C + psi_II (2 I_C - 2 (s_j^2 - s_j s_k + s_k^2)) + s_i psi_J
flip_i  =                       2 psi_C + psi_II (2 I_C - 2 (s_j^2 + s_j s_k + s_k^2)) - s_i psi_J
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from random import Random

import mpmath
import sympy

from fem_snh.kernels.codegen.divided_differences import Divided
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import INVARIANTS, SIGMA

I1, I_C, II_C, J = INVARIANTS
_POINTS, _ZERO = 16, 1e-30


class Derivatives:
    """Derivatives of psi in its measures.

    first, second : the symbol of each that does not vanish identically.
    derivatives : the expression of each symbol.
    """

    def __init__(self, energy: Energy) -> None:
        self.energy = energy
        self.first: dict[sympy.Symbol, sympy.Symbol] = {}
        self.second: dict[tuple[sympy.Symbol, sympy.Symbol], sympy.Symbol] = {}
        self.derivatives: dict[sympy.Symbol, sympy.Expr] = {}
        if energy.of_stretches:
            slopes = dict(zip(SIGMA, energy.slopes, strict=True))
            for s in SIGMA:
                self._add(self.first, s, f"psi_{s}", slopes[s])
            for s, t in combinations_with_replacement(SIGMA, 2):
                # The symmetric part: of a stress that is no gradient there is no other matrix.
                derivative = sympy.diff(slopes[s], t)
                if not energy.has_energy:
                    derivative = (derivative + sympy.diff(slopes[t], s)) / 2
                self._add(self.second, (s, t), f"psi_{s}_{t}", derivative)
            return
        for m in energy.measures:
            self._add(self.first, m, f"psi_{m}", sympy.simplify(sympy.diff(energy.psi, m)))
        for m, n in combinations_with_replacement(energy.measures, 2):
            second = sympy.simplify(sympy.diff(energy.psi, m, n))
            self._add(self.second, (m, n), f"psi_{m}_{n}", second)

    def _add(self, table: dict, key: object, name: str, expression: sympy.Expr) -> None:
        if expression != 0:
            table[key] = sympy.Symbol(name)
            self.derivatives[table[key]] = expression

    def d(self, *measures: sympy.Symbol) -> sympy.Expr:
        """The symbol of a derivative of psi, or 0 where it vanishes identically."""
        if len(measures) == 1:
            return self.first.get(measures[0], sympy.Integer(0))
        m, n = sorted(measures, key=self.energy.measures.index)
        return self.second.get((m, n), sympy.Integer(0))

    def slope(self, s: sympy.Symbol) -> sympy.Expr:
        """dpsi/ds by the chain rule over the measures."""
        if self.energy.of_stretches:
            return self.d(s)
        return sum(self.d(m) * sympy.diff(INVARIANTS[m], s) for m in self.energy.measures)

    def curvature(self, s: sympy.Symbol, t: sympy.Symbol) -> sympy.Expr:
        """d2psi/ds dt by the chain rule over the measures."""
        if self.energy.of_stretches:
            return self.d(s, t)
        measures = self.energy.measures
        total = sum(self.d(m) * sympy.diff(INVARIANTS[m], s, t) for m in measures)
        for m in measures:
            for n in measures:
                ds, dt = sympy.diff(INVARIANTS[m], s), sympy.diff(INVARIANTS[n], t)
                total += self.d(m, n) * ds * dt
        return sympy.sympify(total)

    def pair(
        self, si: sympy.Symbol, sj: sympy.Symbol, sk: sympy.Symbol
    ) -> tuple[sympy.Expr, sympy.Expr]:
        """twist_i and flip_i (module docstring)."""
        if self.energy.of_stretches:
            return self._twist(sj, sk), self._flip(sj, sk)
        common = 2 * self.d(I_C)
        area = 2 * self.d(II_C)
        total = sum(s**2 for s in SIGMA)
        twist = common + area * (total - (sj**2 - sj * sk + sk**2)) + si * self.d(J)
        flip = common + area * (total - (sj**2 + sj * sk + sk**2)) - si * self.d(J)
        if self.d(I1) != 0:
            twist += 2 * self.d(I1) * sympy.Function("inverse_sum")(sj, sk)
        return twist, flip

    def _flip(self, sj: sympy.Symbol, sk: sympy.Symbol) -> sympy.Expr:
        slope = self.derivatives.get(self.slope(sj), sympy.Integer(0))
        difference = self.slope(sj) - self.slope(sk)
        return sympy.Function("quotient")(difference, sj - sk, sj + sk, Divided(sj, sk)(slope))

    def _twist(self, sj: sympy.Symbol, sk: sympy.Symbol) -> sympy.Expr:
        """The sum in place of the difference: it vanishes for inverted stretches alone."""
        total = self.slope(sj) + self.slope(sk)
        slope = self.derivatives.get(self.slope(sj), sympy.Integer(0))
        divided = Divided(sj, sk, sign=-1)
        other = self.derivatives.get(self.slope(sk), sympy.Integer(0))
        if self.energy.inversion_safe and _vanishes(divided.exchanged(slope) + other):
            return sympy.Function("quotient")(total, sj + sk, sj - sk, divided(slope))
        return total * sympy.Function("inverse_sum")(sj, sk)


def _vanishes(expression: sympy.Expr) -> bool:
    """Whether it is zero at every one of some random points, to 30 of 50 digits.

    To prove it takes sympy.simplify minutes where an energy is in pieces.
    """
    symbols, random = sorted(expression.free_symbols, key=str), Random(0)
    value = sympy.lambdify(symbols, expression, "mpmath")
    with mpmath.workdps(50):
        for _ in range(_POINTS):
            point = [mpmath.mpf(random.uniform(0.1, 2)) for _ in symbols]
            signs = [random.choice((-1, 1)) if s in SIGMA else 1 for s in symbols]
            if abs(value(*(x * sign for x, sign in zip(point, signs, strict=True)))) > _ZERO:
                return False
    return True
