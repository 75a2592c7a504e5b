r"""UFL forms of a material, from the same expression as the compiled kernels.

The solver uses the kernels, which are faster and never produce NaN. The forms serve programs that
use a material with dolfinx's assemblers, tests as a reference, and ``python -m benchmarks
assembly`` as its baseline.

An energy of the invariants is written in F itself. The derivatives of an energy of the principal
stretches must not contain the derivatives of the singular vectors of F: these do not exist where
two stretches are equal, and lose digits where two are close. With rotations U and V that are
constants for UFL and diagonalise F at the point of evaluation (`PrincipalFrame`),

.. math:: B = U^T F V

has the stretches of F, is linear in F, and is diagonal at that point. So an isotropic energy is, up
to third order in the off-diagonal entries,

.. math::

    \psi(B) = \psi(B_{00}, B_{11}, B_{22})
        + \frac14 \sum_{j<k} \left( \lambda^\mathrm{twist}_{jk} (B_{jk} - B_{kj})^2
        + \lambda^\mathrm{flip}_{jk} (B_{jk} + B_{kj})^2 \right)

with the twist and flip eigenvalues of the Hessian (`fem_snh.kernels.codegen.derivatives`). The
off-diagonal entries have the value 0. Therefore this expression has the value and the first and
second derivatives of the energy, whatever the derivatives of the eigenvalues are: UFL treats the
stretches in the eigenvalues as constants.

The third derivatives are wrong. The value and the first two derivatives agree with the kernels to a
relative 1e-12 while no stretch is more than 30 times another; for larger ratios, the error grows as
the square of the ratio.

UFL has no operator whose value is its operand and whose derivative is 0. It differentiates
``conditional(c, a, b)`` with constants a and b to 0, so `freeze` assembles a number from binary
digits, each of which is such a conditional.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import sympy
import ufl
from ufl.classes import Variable
from ufl.core.expr import Expr

from fem_snh.errors import BadInput
from fem_snh.kernels.codegen.derivatives import Derivatives
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA

#: Binary digits of a frozen number: the significand of a double.
_DIGITS = 53
#: Bisection steps for the power of two above a norm; they find powers from 2^-63 to 2^64.
_EXPONENTS = (64, 32, 16, 8, 4, 2, 1)
#: Positive number far below rounding; it keeps quotients 0/0 finite.
_TINY = 1e-30


class Named(Variable):
    """A variable that prints as a name, because its expression is astronomically long.

    Parameters
    ----------
    expression : UFL expression
        The value.
    name : str
        What `str` and `repr` return.
    """

    __slots__ = ("_name",)

    def __init__(self, expression: Expr, name: str) -> None:
        super().__init__(expression)
        self._name = name

    def __str__(self) -> str:
        return self._name

    __repr__ = __str__


# UFL compares two variables by their labels. Without variables, a comparison would follow every
# path through the expressions.
_store = ufl.variable


class PrincipalFrame:
    r"""The frame of singular vectors of F at the point of evaluation.

    Parameters
    ----------
    F : UFL expression
        The (3, 3) deformation gradient.

    Attributes
    ----------
    B : UFL expression
        (3, 3), U^T F V, diagonal in value. UFL differentiates B as if U and V were constants.
    stretches : tuple of UFL expressions
        The three signed stretches in the order of the diagonal of B, not sorted, with derivative 0.
        If det F < 0, the smallest stretch is negative (rotation-variant singular value
        decomposition, Smith et al. 2018, section 2).
    """

    def __init__(self, F: Expr) -> None:
        X, scale = freeze_tensor(F)
        U, V = (Named(R, name) for R, name in zip(rotations(X), ("U(F)", "V(F)"), strict=True))
        self.B = Named(U.T * F * V, "B")
        D = _store(U.T * X * V)
        self.stretches = tuple(Named(scale * D[i, i], f"s{i}") for i in range(3))


def freeze(x: Expr) -> Expr:
    r"""Return a scalar between -1 and 1 as an expression whose derivative in UFL is 0.

    Notes
    -----
    With :math:`r_0 = x` and :math:`r_k = |r_{k-1}| - 2^{-k}`, which lies between
    :math:`\pm 2^{-k}`,

    .. math:: x = \pm (2^{-1} \pm (2^{-2} \pm (\ldots))), \qquad \text{the signs those of } r_k .

    The error is at most :math:`2^{-53}`.
    """
    value, sign = ufl.as_ufl(0.0), ufl.as_ufl(1.0)
    remainder = x
    for k in range(1, _DIGITS + 1):
        # The sum of signed digits: gcc 14 compiles the nested form above seven times as long.
        sign *= ufl.conditional(ufl.ge(remainder, 0), 1.0, -1.0)
        value += sign * 2.0**-k
        remainder = abs(remainder) - 2.0**-k
    return value


def freeze_tensor(F: Expr) -> tuple[Expr, Expr]:
    """Return (X, a) with a X = F and derivatives 0, where a is a power of 2 and ``|X_ij| < 1``."""
    norm = _store(ufl.sqrt(ufl.inner(F, F)))
    a: Expr = ufl.as_ufl(2.0 ** -_EXPONENTS[0])
    for e in _EXPONENTS:
        larger = a * 2.0**e
        a = _store(ufl.conditional(ufl.ge(norm, larger), larger, a))
    a = _store(2 * a)
    X = [[freeze(_store(F[i, j] / a)) for j in range(3)] for i in range(3)]
    return _store(ufl.as_matrix(X)), a


def rotations(X: Expr) -> tuple[Expr, Expr]:
    r"""Return rotations (U, V), (3, 3) each, with :math:`U^T X V` diagonal to rounding.

    Parameters
    ----------
    X : UFL expression
        (3, 3), with a largest entry between 1/6 and 1.

    Notes
    -----
    Of the extreme eigenvalues of C = X^T X, take the one farther from the middle eigenvalue. The
    trigonometric solution of the cubic gives this eigenvalue to rounding, and cross products give
    its eigenvector v. The rest is the singular value decomposition of a 2x2 matrix, in closed form.
    """
    C = X.T * X
    A = _store(C - ufl.tr(C) / 3 * ufl.Identity(3))
    p = _store(ufl.sqrt(ufl.inner(A, A) / 6) + _TINY)
    r = _store(ufl.det(A / p) / 2)
    side = _store(ufl.conditional(ufl.ge(r, 0), 1.0, -1.0))
    root = 2 * ufl.cos(ufl.acos(ufl.min_value(side * r, 1.0)) / 3)
    v = _store(_null_vector(_store(side / p * A - root * ufl.Identity(3))))
    # u is parallel to X v and to cof(X) v; take the product that cannot vanish.
    rows = [_row(X, i) for i in range(3)]
    cofactor = [ufl.dot(ufl.cross(rows[i - 2], rows[i - 1]), v) for i in range(3)]
    direct = X * v
    u = [ufl.conditional(ufl.ge(side, 0), direct[i], cofactor[i]) for i in range(3)]
    u = _store(_unit_vector(ufl.as_vector(u), v))
    (t0, t1), (w0, w1) = _complement(u), _complement(v)
    a, b, c, d = (_store(ufl.dot(t, X * w)) for t in (t0, t1) for w in (w0, w1))
    # [[a, b], [c, d]] is a multiple of a rotation plus a multiple of a reflection.
    cos_a, sin_a = _half_angle(a + d, c - b)
    cos_b, sin_b = _half_angle(a - d, b + c)
    U = _turn(t0, t1, cos_a * cos_b - sin_a * sin_b, sin_a * cos_b + cos_a * sin_b)
    V = _turn(w0, w1, cos_a * cos_b + sin_a * sin_b, cos_a * sin_b - sin_a * cos_b)
    return _columns(*U, u), _columns(*V, v)


def _row(A: Expr, i: int) -> Expr:
    return ufl.as_vector([A[i, j] for j in range(3)])


def _columns(*vectors: Expr) -> Expr:
    return ufl.as_matrix([[x[i] for x in vectors] for i in range(3)])


def _null_vector(A: Expr) -> Expr:
    """Return the unit vector that a symmetric (3, 3) matrix of rank 2 maps to 0."""
    rows = [_row(A, i) for i in range(3)]
    best, *others = (_store(ufl.cross(rows[i], rows[i - 1])) for i in range(3))
    for x in others:
        longer = ufl.gt(ufl.dot(x, x), ufl.dot(best, best))
        best = _store(ufl.as_vector([ufl.conditional(longer, x[i], best[i]) for i in range(3)]))
    return best / ufl.sqrt(ufl.dot(best, best))


def _unit_vector(x: Expr, other: Expr) -> Expr:
    """Return x/|x|, or the unit vector ``other`` where x is 0."""
    x = _store(x)
    length = _store(ufl.sqrt(ufl.dot(x, x)))
    positive = ufl.gt(length, _TINY)
    return ufl.as_vector(
        [ufl.conditional(positive, x[i] / (length + _TINY), other[i]) for i in range(3)]
    )


def _complement(n: Expr) -> tuple[Expr, Expr]:
    """Return unit vectors that form a right-handed orthonormal frame with the unit vector n.

    References
    ----------
    Duff et al. 2017, Building an orthonormal basis, revisited.
    """
    sign = _store(ufl.conditional(ufl.ge(n[2], 0), 1.0, -1.0))
    a = _store(-1 / (sign + n[2]))
    b = _store(n[0] * n[1] * a)
    first = ufl.as_vector([1 + sign * n[0] ** 2 * a, sign * b, -sign * n[0]])
    second = ufl.as_vector([b, sign + n[1] ** 2 * a, -n[1]])
    return _store(first), _store(second)


def _half_angle(x: Expr, y: Expr) -> tuple[Expr, Expr]:
    """Return (cos, sin) of half the polar angle of (x, y); (1, 0) for the zero vector."""
    length = _store(ufl.sqrt(x**2 + y**2) + _TINY)
    x, y = _store(x / length), _store(y / length)
    right = ufl.ge(x, 0)
    c, s = (_store(ufl.conditional(right, *pair)) for pair in ((1 + x, y), (y, 1 - x)))
    length = _store(ufl.sqrt(c**2 + s**2))
    return _store(c / length), _store(s / length)


def _turn(x: Expr, y: Expr, c: Expr, s: Expr) -> tuple[Expr, Expr]:
    """Return the vectors x and y rotated in their plane by the angle with cosine c and sine s."""
    c, s = _store(c), _store(s)
    return _store(c * x + s * y), _store(c * y - s * x)


#: (i, j, k): twist i and flip i couple the stretches j and k.
_PAIRS = ((0, 1, 2), (1, 0, 2), (2, 0, 1))

#: UFL's functions, by the names that sympy prints.
FUNCTIONS = {
    "log": ufl.ln,
    "log1p": lambda x: ufl.ln(1 + x),
    "exp": ufl.exp,
    "sqrt": ufl.sqrt,
    "where": lambda x, a, b: ufl.conditional(ufl.gt(x, 0), a, b),
}


def off_diagonal_terms(energy: Energy, frame: PrincipalFrame) -> Expr:
    """Return the sum over j < k of the module's expansion; value and first derivative are 0.

    Parameters
    ----------
    energy : Energy
        An energy with ``of_stretches``.
    frame : PrincipalFrame
        The principal frame of the deformation gradient.
    """
    B, s = frame.B, frame.stretches
    eigenvalues = _twist_and_flip(energy)
    total: Expr = 0
    for i, j, k in _PAIRS:
        twist, flip = eigenvalues(s[i], s[j], s[k], *energy.values)
        total += Named(twist, f"twist{i}(s)") * (B[j, k] - B[k, j]) ** 2 / 4
        total += Named(flip, f"flip{i}(s)") * (B[j, k] + B[k, j]) ** 2 / 4
    return total


def trace_of_stretch(F: Expr) -> Expr:
    """Return I1 = tr S, the sum of the signed stretches, as a UFL expression.

    Its twist eigenvalues are 2/(s_j + s_k), its flip eigenvalues 0.
    """
    frame = PrincipalFrame(F)
    B, s = frame.B, frame.stretches
    twists = ((B[j, k] - B[k, j]) ** 2 / 2 * _inverse_sum(s[j], s[k]) for _, j, k in _PAIRS)
    return ufl.tr(B) + sum(twists)


def _twist_and_flip(energy: Energy) -> Callable[..., tuple[Expr, Expr]]:
    """Return the function (twist_i, flip_i) of the stretches s_i, s_j, s_k and the constants."""
    derivatives = Derivatives(energy)
    pair: Sequence[sympy.Expr] = derivatives.twist_and_flip(*SIGMA)
    expanded = [sympy.sympify(x).xreplace(derivatives.derivatives) for x in pair]
    arguments = (*SIGMA, *energy.constants)
    return sympy.lambdify(arguments, expanded, modules=_FROZEN_FUNCTIONS, cse=True)


# --- functions of kernels/include/divided_differences.h and log_exp_series.h, in UFL ------------


def _quotient(numerator: Expr, denominator: Expr, partner: Expr, divided: Expr) -> Expr:
    close = ufl.le(abs(denominator), 0.1 * abs(partner))
    return ufl.conditional(close, divided, numerator / ufl.conditional(close, 1.0, denominator))


def _inverse_sum(a: Expr, b: Expr) -> Expr:
    return 1 / ufl.max_value(a + b, 1e-15 * (abs(a) + abs(b)) + 1e-30)


def _log1p_over_x(x: Expr) -> Expr:
    x = ufl.variable(x)
    z = ufl.variable(x / (2 + x))
    w = ufl.variable(z * z)
    total: Expr = 1.0 / 19
    for n in range(17, 0, -2):
        total = total * w + 1.0 / n
    small = ufl.le(abs(x), 0.25)
    y = ufl.variable(ufl.conditional(small, 1.0, x))
    return ufl.conditional(small, 2 * total / (2 + x), ufl.ln(1 + y) / y)


def _expm1_over_x(x: Expr) -> Expr:
    x = ufl.variable(x)
    total: Expr = 1.0
    for n in range(14, 1, -1):
        total = 1 + total * x / n
    small = ufl.le(abs(x), 0.5)
    y = ufl.variable(ufl.conditional(small, 1.0, x))
    return ufl.conditional(small, total, (ufl.exp(y) - 1) / y)


def _powm1_over_x(x: Expr, a: Expr) -> Expr:
    quotient = ufl.variable(a * _log1p_over_x(x))
    return quotient * _expm1_over_x(quotient * x)


_FROZEN_FUNCTIONS = FUNCTIONS | {
    "quotient": _quotient,
    "inverse_sum": _inverse_sum,
    "log1p_over_x": _log1p_over_x,
    "expm1_over_x": _expm1_over_x,
    "powm1_over_x": _powm1_over_x,
}


def energy_density(energy: Energy, F: Expr) -> Expr:
    """Return the energy density psi(F) [Pa] as a UFL expression; NaN where the kernels give +inf.

    Parameters
    ----------
    energy : Energy
        A material's energy: ``material(...).expression``.
    F : UFL expression
        The (3, 3) deformation gradient.

    Raises
    ------
    BadInput
        For a material that has a stress but no energy.

    Notes
    -----
    An energy of the invariants I_C, II_C and J is written in F itself. Energies of the principal
    stretches, and of their sum I1, have the form that the module describes.
    """
    if not energy.has_energy:
        raise BadInput(f"material '{energy.name}' has no energy, only a stress")
    rest: Expr = 0
    if energy.of_stretches:
        frame = PrincipalFrame(F)
        measures = [frame.B[i, i] for i in range(3)]
        rest = off_diagonal_terms(energy, frame)
    else:
        measures = [_INVARIANTS[str(m)](F) for m in energy.measures]
    for barrier in energy.barriers:
        inside = sympy.lambdify(energy.measures, barrier, modules=FUNCTIONS)(*measures)
        rest += ufl.ln(ufl.conditional(ufl.gt(inside, 0), 1.0, -1.0))  # 0 inside, NaN outside
    return energy.evaluate(FUNCTIONS, *measures) + rest


def _area(F: Expr) -> Expr:
    C = F.T * F
    return (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2


_INVARIANTS = {
    "I1": trace_of_stretch,
    "I_C": lambda F: ufl.tr(F.T * F),
    "II_C": _area,
    "J": ufl.det,
}
