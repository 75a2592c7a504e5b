"""The energy of a material with its shape parameters as unknowns: symbols first, then numpy.

The material's function is called with symbols for the parameters that are fitted. Its principal
stresses and their derivatives become numpy functions of the stretches and of the parameters, at
E = 1: the stress is proportional to E.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
import sympy

from fem_snh import materials
from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value, choose
from fem_snh.materials import normalise, tuning
from fem_snh.materials.construction import symbolic
from fem_snh.materials.energy import LAME
from fem_snh.materials.invariants import INVARIANTS, SIGMA, Parameter, domain
from fem_snh.materials.parameters import (
    ALPHAS,
    LARGEST_PARAMETER,
    MAX_EXPONENT,
    constants_of,
    default_variants,
    ranges,
)

#: mu_lame and lambda_lame at which an incompressible material of E = 1 is evaluated; its pressure
#: removes the effect of lambda_lame.
_INCOMPRESSIBLE = (1 / 3, 1.0)
#: Stretches of volume 1, at which lambda may change the pressure only.
_ISOCHORIC = np.array([[1.3, 1.1, 1 / 1.43], [0.8, 1.6, 1 / 1.28]])
#: Largest size of an unknown without another bound, relative to its start or to 1.
_LARGEST = 1e3
#: Distance of a bound from the end of a range that excludes it.
_OPEN = 1e-6
#: Relative difference of stresses that counts as rounding.
_ROUNDING = 1e-9
#: Modules of `sympy.lambdify`.
_NUMPY = [{"where": lambda x, a, b: np.where(x > 0, a, b)}, "numpy"]


@dataclass(frozen=True)
class Unknown:
    """A number of a material that is fitted.

    Attributes
    ----------
    name : str
        The parameter, or "name[0]" for an entry of a tuple.
    parameter : str
        The parameter.
    index : int or None
        The position in the tuple.
    start, low, high : float
        First value and bounds.
    constant : bool
        Whether it is one of the material's constants, in units of E.
    """

    name: str
    parameter: str
    index: int | None
    start: float
    low: float
    high: float
    constant: bool


def accepted_range(function: Callable[..., Any], parameter: str) -> tuple[float, float]:
    """Return the least and the largest value that a parameter of a material function may have."""
    if parameter == "alpha":
        return ALPHAS
    if (accepted := ranges(function).get(parameter)) is None:
        return -inf, inf
    low, high = accepted.low, min(accepted.high, LARGEST_PARAMETER)
    return low + _OPEN * accepted.open_low, high - _OPEN * accepted.open_high


class Family:
    """The energies of a material for all values of its unknown parameters.

    Parameters
    ----------
    material : str or callable
        As for `fem_snh.material`.
    incompressible : bool
        Whether J = 1.
    nu : float
        Poisson's ratio of a compressible material.
    held : mapping
        Values of parameters that are not fitted.
    parameters : sequence of str, optional
        The parameters that are fitted, besides E and nu; default: all with numerical values.
    bounds : mapping
        (lowest, highest) value of parameters; constants in units of E.

    Raises
    ------
    BadInput
        For an unknown material or parameter, and if lambda is not only a factor of a volume term in
        an incompressible material.
    """

    def __init__(
        self,
        material: Any,
        incompressible: bool,
        nu: float,
        held: Mapping[str, Any],
        parameters: Sequence[str] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.name = materials.label(material)
        self.incompressible = incompressible
        if taken := sorted({"E", "nu"} & held.keys()):
            accepted = "a shape parameter; E is fitted, and nu given by itself (--nu)"
            raise bad_value("held", taken[0], accepted)
        made = materials.make_energy(material, 1.0, 0.5 if incompressible else nu, **held)
        self.function = materials.function(material)
        if held.get("lambda_part") is not None or not {"alpha_mu", "alpha_lambda"}.isdisjoint(held):
            raise BadInput(f"material '{self.name}': a fit takes alpha and epsilon of the tuning")
        self._known = materials.defaults(material) | {
            k: v for k, v in made.shape.items() if v is not None
        }
        self._held = dict(held) | default_variants(self.function, made.nu, held)
        self._tuned = "alpha" in (parameters or ()) or held.get("alpha") is not None
        if self._tuned:
            self._known.setdefault("alpha", 1.0)
        self._pins = self._pinned(held, made.fit.moduli)
        for key, value in self._pins.items():
            self._known.setdefault(key, value)
        candidates = [k for k, v in self._known.items() if k not in held and _numerical(v)]
        if parameters is not None:
            for key in parameters:
                choose("parameters", key, ["E", "nu", *candidates])
            candidates = [k for k in candidates if k in parameters]
        for key, (low, high) in (bounds or {}).items():
            choose("bounds", key, candidates)
            if not low < high:
                raise bad_value(f"bounds of {key}", (low, high), "the lowest value first")
        self._bounds = dict(bounds or {})
        self.depends_on_nu = "nu" in inspect.signature(self.function).parameters
        self._symbols: dict[str, sympy.Symbol] = {}
        self._fixed: dict[int, float] = {}
        self.unknowns: tuple[Unknown, ...] = ()
        self._build(candidates, nu)

    def _pinned(self, held: Mapping[str, Any], moduli: normalise.Pair) -> dict[str, float]:
        """Return {constant: default [E]} of the constants that E and nu do not determine."""
        constants = constants_of(self.function)
        symbols = {c: sympy.Symbol(c, real=True) for c in constants}
        known = {symbols[c]: held[c] for c in constants if held.get(c) is not None}
        defaults = {
            c: float(v) for c, v in constants.items() if v is not None and symbols[c] not in known
        }
        mu, lam = (m.subs(known) for m in moduli)
        # E and nu determine the last constants if they can, otherwise earlier ones.
        free = normalise.determined((mu, lam), [symbols[c] for c in reversed(defaults)])
        return {c: v for c, v in defaults.items() if symbols[c] not in free}

    def _build(self, fitted: list[str], nu: float) -> None:
        """Call the material's function with symbols; set ``unknowns`` and the numpy functions."""
        of_no_function = [k for k in fitted if k in (*self._pins, "alpha")]
        # A function that compares a parameter gets a symbol with the sign of the default. One that
        # checks the size of a parameter accepts no symbol.
        for signed, names in ((False, fitted), (True, fitted), (True, of_no_function)):
            try:
                stress, barriers = self._call(names, nu, signed)
                break
            except BadInput:
                if names is of_no_function:
                    raise
        if self._tuned:
            stress = self._nonlinear(stress, barriers)
        symbols = tuple(self._symbols.values())
        exponents = {p.exp for e in stress for p in e.atoms(sympy.Pow)}
        powers = set().union(*(e.free_symbols for e in exponents)) if exponents else set()
        self.unknowns = tuple(
            self._unknown(name, symbol, signed, symbol in powers)
            for name, symbol in self._symbols.items()
        )
        arguments = (*SIGMA, *LAME, *symbols)
        second = [sympy.diff(p, s) for p in stress for s in SIGMA]
        limits = [d.subs(INVARIANTS) for d in domain(stress, SIGMA, barriers)]
        self._stress = sympy.lambdify(arguments, list(stress), modules=_NUMPY, cse=True)
        self._second = sympy.lambdify(arguments, second, modules=_NUMPY, cse=True)
        self._limits = sympy.lambdify(arguments, limits, modules=_NUMPY, cse=True)
        self._scale_free()
        if not np.abs(Member(self, self.start, None).stress(np.ones(3))).max() <= _ROUNDING:
            raise BadInput(f"material '{self.name}' is stressed at rest: expected another one")
        if self.incompressible:
            self._check_volume()

    def _call(
        self, fitted: list[str], nu: float, signed: bool
    ) -> tuple[tuple[sympy.Expr, ...], set[sympy.Expr]]:
        """Return the principal stresses as expressions in stretches and `LAME`, and the barriers.

        Sets ``_symbols``.
        """
        self._symbols = {}
        values = dict(self._known)
        for key in fitted:
            default = self._known[key]
            if isinstance(default, tuple):
                names = [f"{key}[{i}]" for i in range(len(default))]
                made = tuple(_symbol(n, v, signed) for n, v in zip(names, default, strict=True))
                self._symbols |= dict(zip(names, made, strict=True))
                values[key] = made
            else:
                self._symbols[key] = values[key] = _symbol(key, default, signed)
        shape = {k: values[k] for k in materials.defaults(self.function)}
        form = symbolic(self.function, self.name, 0.5 if self.incompressible else nu, shape)
        pinned = {c: values.get(str(c)) for c in form.constants if str(c) in self._pins}
        held = {c: self._held[str(c)] for c in form.constants if self._held.get(str(c)) is not None}
        stresses = [p.subs(pinned | held) for p in form.slopes]
        free = [c for c in form.constants if c not in pinned and c not in held]
        constants = constants_of(self.function)
        defaults = {c: float(v) for c in free if (v := constants[str(c)]) is not None}
        moduli = normalise.linearised(stresses)
        fit = normalise.Normalisation(self.name, free, defaults, {}, moduli)
        solved = fit.solve(LAME, 1.0, mixed=self.incompressible or len(free) == 1)
        swap = dict(zip(free, solved, strict=True))
        return (
            tuple(p.subs(swap, simultaneous=True) for p in stresses),
            {b.subs(INVARIANTS) for b in form.barriers},
        )

    def _nonlinear(
        self, stress: tuple[sympy.Expr, ...], barriers: set[sympy.Expr]
    ) -> tuple[sympy.Expr, ...]:
        """Return the stresses of psi(s^alpha)/alpha^2 (Chen & Barbic, eq. 16)."""
        alpha = self._symbols.get("alpha", self._known["alpha"])
        epsilon = self._held.get("epsilon")
        if epsilon is None:
            epsilon = 0 if domain(stress, SIGMA, barriers) else tuning.EPSILON
        return tuning.nonlinear(None, stress, alpha, epsilon)[1]

    def _unknown(self, name: str, symbol: sympy.Symbol, signed: bool, power: bool) -> Unknown:
        """Return the unknown of a symbol, with its bounds."""
        parameter, _, rest = name.partition("[")
        index = int(rest[:-1]) if rest else None
        value = self._known[parameter]
        start = float(value if index is None else value[index])
        high = _LARGEST * max(1.0, abs(start))
        low = -high
        if power:
            low, high = -float(MAX_EXPONENT), float(MAX_EXPONENT)
        least, most = accepted_range(self.function, parameter)
        low, high = max(low, least), min(high, most)
        if signed and start:
            low, high = (max(low, 0.0), high) if start > 0 else (low, min(high, 0.0))
        if parameter in self._bounds:
            low, high = self._bounds[parameter]
            start = min(max(start, low), high)
        return Unknown(name, parameter, index, start, low, high, parameter in self._pins)

    def _scale_free(self) -> None:
        """Fix the largest entry of each tuple whose common factor does not change the stress."""
        theta = self.start
        s = _ISOCHORIC
        reference = Member(self, theta, None).stress(s)
        held = []
        for parameter in {u.parameter for u in self.unknowns if u.index is not None}:
            mine = [k for k, u in enumerate(self.unknowns) if u.parameter == parameter]
            doubled = theta.copy()
            doubled[mine] *= 2
            with np.errstate(all="ignore"):
                change = np.abs(Member(self, doubled, None).stress(s) - reference).max()
            if change <= _ROUNDING * np.abs(reference).max():
                held.append(max(mine, key=lambda k: abs(theta[k])))
        self._fixed = {k: float(theta[k]) for k in held}
        self.unknowns = tuple(u for k, u in enumerate(self.unknowns) if k not in held)

    def _check_volume(self) -> None:
        """Raise BadInput unless lambda multiplies a function of J alone."""
        s = _ISOCHORIC
        mu, lam = _INCOMPRESSIBLE
        laws = (Member(self, self.start, None, (mu, size * lam)) for size in (1, 2))
        work = [s * law.stress(s) for law in laws]
        difference = np.diff(work[1] - work[0], axis=-1)
        if not np.abs(difference).max() <= _ROUNDING * np.abs(work[0]).max():
            raise BadInput(
                f"material '{self.name}' has no volume term, one in J alone that brings lambda: "
                "an incompressible one has no stress: expected nu = a number below 0.5"
            )

    @property
    def start(self) -> Array:
        """Return the first values of the unknowns, (k,)."""
        return np.array([u.start for u in self.unknowns])

    def at(self, theta: Array, nu: float | None) -> Member:
        """Return the energy with the values ``theta`` (k,) of the unknowns, at E = 1."""
        return Member(self, theta, None if self.incompressible else nu)

    def all_values(self, theta: Array) -> list[float]:
        """Return the values of all symbols, also of those that are fixed."""
        rest, fixed = iter(theta), self._fixed
        values = [fixed[k] if k in fixed else next(rest) for k in range(len(self._symbols))]
        return list(np.array(values, dtype=np.float64))  # unlike Python's, powers may be infinite

    def shape(self, theta: Array, E: float) -> dict[str, Any]:
        """Return the keywords of `fem_snh.material` besides E and nu."""
        found = dict(self._held)
        for name, value in zip(self._symbols, self.all_values(theta), strict=True):
            parameter, bracket, _ = name.partition("[")
            size = E if parameter in self._pins else 1.0
            found[parameter] = (*found.get(parameter, ()), value) if bracket else value * size
        return found


class Member:
    """One energy of a `Family`, at E = 1; it is incompressible if its ``nu`` is None."""

    def __init__(
        self,
        family: Family,
        theta: Array,
        nu: float | None,
        lame: tuple[float, float] = _INCOMPRESSIBLE,
    ) -> None:
        self.nu, self._family = nu, family
        moduli = lame if nu is None else normalise.lame(1.0, nu)
        self._values = (*moduli, *family.all_values(theta))

    def _evaluate(self, function: Any, s: Array) -> Array:
        with np.errstate(all="ignore"):
            found = function(*np.moveaxis(s, -1, 0), *self._values)
            outside = np.zeros(s.shape[:-1], dtype=bool)
            for d in self._family._limits(*np.moveaxis(s, -1, 0), *self._values):
                outside |= ~(np.asarray(d) > 0)
        out = np.stack([np.broadcast_to(f, s.shape[:-1]) for f in found], axis=-1).astype(float)
        return np.where(outside[..., None], np.nan, out)

    def stress(self, s: Array) -> Array:
        """Return dpsi/ds_i, (..., 3), of stretches (..., 3); NaN outside the energy's domain."""
        return self._evaluate(self._family._stress, s)

    def tangent(self, s: Array) -> Array:
        """Return d2psi/ds_i ds_j, (..., 3, 3)."""
        return self._evaluate(self._family._second, s).reshape(*s.shape[:-1], 3, 3)


def _numerical(value: Any) -> bool:
    """Return whether a shape parameter is a number or a tuple of numbers."""
    if isinstance(value, tuple):
        return bool(value) and all(map(_numerical, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def _symbol(name: str, value: float, signed: bool) -> sympy.Symbol:
    """Return the symbol of a parameter, with the sign of its value if ``signed``."""
    if signed and value:
        return Parameter(name, **{"positive" if value > 0 else "negative": True})
    return Parameter(name, real=True)
