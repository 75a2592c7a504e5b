"""m.ufl(F), differentiated by UFL, against the kernels."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from points import NO_ENERGY, deformations, make
from ufl import classes
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from fem_snh import _dolfinx, materials
from fem_snh.kernels.ufl_forms import PrincipalFrame
from fem_snh.mesh import mesh

NU = 0.3
ENERGIES = [n for n in materials.names() if n not in NO_ENERGY]
#: F = I; three equal stretches; two equal ones, the third larger or smaller; flat and stretched.
UPRIGHT = [(1, 1, 1), (0.8, 0.8, 0.8), (1.3, 1.3, 0.7), (1.3, 0.7, 0.7), (1.4, 0.9, 0.6)]
UPRIGHT += [(3.4, 0.6, 0.5), (1.5, 1.2, 0.05), (30, 20, 10)]
for gap in (1e-1, 1e-4, 1e-8, 1e-12):
    UPRIGHT += [(1 + gap, 1, 1), (1.3 + gap, 1.3, 0.7), (1.3, 0.7 + gap, 0.7)]
    UPRIGHT += [(1.1 + gap, 1.1, 1.1 - gap)]
INVERTED = [(2, 1.2, -0.5), (1.1, 1, -0.9), (1.3, 1.3, -0.7), (1.3, 1.3 + 1e-8, -0.7)]
INVERTED += [(1.2, 0.5, -0.01), (1.1, 0.9, -0.85)]
#: Relative to the largest entry and E; the condition of the stretches is up to 30.
BOUND = 1e-12


# --- values of UFL expressions at many points ----------------------------------------------------
# UFL's own ``expression(point)`` follows every path through the expression, of which there are more
# than 10^20 in an energy of the stretches. Here each subexpression is evaluated once.

_FUNCTIONS = {
    "sqrt": np.sqrt, "exp": np.exp, "ln": np.log, "cos": np.cos, "acos": np.arccos,
    "abs": np.abs, "sign": np.sign, "min_value": np.minimum, "max_value": np.maximum,
    "division": np.divide, "power": np.power, "sum": np.add, "product": np.multiply,
    "lt": np.less, "gt": np.greater, "le": np.less_equal, "ge": np.greater_equal,
    "real": np.asarray, "conj": np.asarray,
}  # fmt: skip

Indices = dict[int, int]


def value(expression: Any, points: dict[Any, np.ndarray]) -> np.ndarray:
    """The values (n, *shape) of an expression where its terminals have the (n, *shape) values."""
    return Values(points)(_expanded(expression))


def energy_and_derivatives(psi: Any, variable: Any, points: dict[Any, np.ndarray]) -> list[Any]:
    """psi (n,), UFL's first (n, 3, 3) and second derivative (n, 3, 3, 3, 3) by a UFL variable.

    ``points`` gives the (n, *shape) values of the terminals.
    """
    P = _expanded(ufl.diff(psi, variable))
    values = Values(points)
    return [values(e) for e in (_expanded(psi), P, _expanded(ufl.diff(P, variable)))]


def _expanded(expression: Any) -> Any:
    return apply_derivatives(apply_algebra_lowering(expression))


class Values:
    """Values of expanded expressions of terminals with the values ``points``."""

    def __init__(self, points: dict[Any, np.ndarray]) -> None:
        self._points = points
        self._known: dict[Any, tuple[Any, Any]] = {}

    def __call__(self, e: Any) -> np.ndarray:
        """(n, *shape)."""
        with np.errstate(all="ignore"):
            found = [self._value(e, c, {}) for c in np.ndindex(*e.ufl_shape)]
        return np.stack(np.broadcast_arrays(*found), axis=-1).reshape(-1, *e.ufl_shape)

    def _value(self, e: Any, component: tuple[int, ...], at: Indices) -> Any:
        key = (id(e), component, tuple(at[i] for i in e.ufl_free_indices))
        if key not in self._known:
            self._known[key] = self._compute(e, component, at), e  # its address stays its own
        return self._known[key][0]

    def _compute(self, e: Any, c: tuple[int, ...], at: Indices) -> Any:
        if e._ufl_is_terminal_:
            return self._terminal(e, c)
        ops = e.ufl_operands
        if isinstance(e, classes.Variable):
            return self._value(ops[0], c, at)
        if isinstance(e, classes.Indexed):
            return self._value(ops[0], tuple(_number(i, at) for i in ops[1]), at)
        if isinstance(e, classes.ComponentTensor):
            own = {i.count(): n for i, n in zip(ops[1], c, strict=True)}
            return self._value(ops[0], (), at | own)
        if isinstance(e, classes.ListTensor):
            return self._value(ops[c[0]], c[1:], at)
        if isinstance(e, classes.IndexSum):
            i = ops[1][0].count()
            return sum(self._value(ops[0], c, at | {i: n}) for n in range(e.dimension()))
        if isinstance(e, classes.Conditional):
            return np.where(self._value(ops[0], (), at), *(self._value(x, c, at) for x in ops[1:]))
        values = [self._value(x, c if x.ufl_shape else (), at) for x in ops]
        return _FUNCTIONS[e._ufl_handler_name_](*values)

    def _terminal(self, e: Any, c: tuple[int, ...]) -> Any:
        if isinstance(e, classes.Zero):
            return np.zeros(1)
        if isinstance(e, classes.ScalarValue):
            return np.full(1, float(e._value))
        if isinstance(e, classes.Identity):
            return np.full(1, float(c[0] == c[1]))
        return self._points[e][(slice(None), *c)]


def _number(index: Any, at: Indices) -> int:
    return int(index) if isinstance(index, classes.FixedIndex) else at[index.count()]


# --- energies ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def constant():
    """A UFL terminal of shape (3, 3); its values are chosen at evaluation."""
    domain = mesh.generate(MPI.COMM_SELF, "cube", "tetrahedron", cells=1).domain
    return _dolfinx.constant(domain, np.eye(3))


def points(m, upright=UPRIGHT, inverted=INVERTED):
    """F (n, 3, 3) in the energy's domain: in the axes, and turned."""
    s = np.array([*upright, *(inverted if m.expression.inversion_safe else [])], dtype=float)
    return np.concatenate([s[:, :, None] * np.eye(3), deformations(s, seed=11)])


def assert_agrees(m, F, constant):
    """Energy, PK1 and Hessian of UFL are the kernels', to BOUND; outside the domain NaN."""
    variable = ufl.variable(constant)
    outside = [] if m.expression.inversion_safe else deformations(np.array(INVERTED), seed=12)
    points = np.concatenate([F, outside]) if len(outside) else F
    found = energy_and_derivatives(m.ufl(variable), variable, {constant: points})
    assert np.isnan(found[0][len(F) :]).all() and np.isinf(m.energy(points[len(F) :])).all()
    psi, P, H = (values[: len(F)] for values in found)
    E = m.expression.E
    expected, stress, hessian = m.energy(F), m.pk1(F), m.hessian(F)
    assert np.all(abs(psi - expected) <= BOUND * (E + abs(expected)))
    size = E + abs(stress).max((1, 2))
    assert np.all(abs(P - stress).max((1, 2)) <= BOUND * size)
    by_columns = H.transpose(0, 2, 1, 4, 3).reshape(-1, 9, 9)
    assert np.all(abs(by_columns - hessian).max((1, 2)) <= BOUND * abs(hessian).max((1, 2)))


@pytest.mark.parametrize("name", ENERGIES)
def test_value_and_derivatives(name, constant):
    m = make(name, NU)
    assert_agrees(m, points(m), constant)


@pytest.mark.parametrize(
    "name, tuning",
    [
        ("corotational", {"alpha": 1.5}),
        ("hencky", {"lambda_part": "stable_neo_hookean"}),
        ("seth_hill", {"n": 3}),
        ("ogden", {"volume": "log"}),
    ],
)
def test_tuned_energies(name, tuning, constant):
    m = make(name, NU, **tuning)
    assert m.expression.needs_stretches
    assert_agrees(m, points(m), constant)


@pytest.mark.one_debian
def test_no_stretch_and_large_numbers(constant):
    """F = 0 has a frame; the size of F does not matter."""
    frame = PrincipalFrame(constant)
    s = [(0, 0, 0), (2, 0, 0), (2e9, 1e9, -1e9), (3e-9, 1e-9, 1e-9)]
    F = deformations(np.array(s), seed=13)
    B = value(frame.B, {constant: F})
    size = np.linalg.norm(F, axis=(1, 2))
    assert np.linalg.norm(B, axis=(1, 2)) == pytest.approx(size, rel=1e-14)
    off = B - value(ufl.diag(ufl.as_vector(frame.stretches)), {constant: F})
    assert np.all(abs(off).max((1, 2)) <= 1e-15 * np.maximum(size, 2.0**-63))
