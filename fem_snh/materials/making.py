r"""Make the energy of a material from its name, (E, nu) and keywords.

E and nu may follow from the material's own constants, or from the constants under which the
literature publishes the material: two of the shear modulus :math:`\mu`, the bulk modulus K, E and
:math:`\nu` determine the others. PK1-linearisation (`fem_snh.materials.normalise`) gives
:math:`\mu` and K in terms of the constants.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from inspect import signature
from typing import Any

import sympy

from fem_snh.errors import BadInput, bad_value, shown, suggestion_for
from fem_snh.materials.construction import construct, symbolic
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA
from fem_snh.materials.normalise import Pair, determined
from fem_snh.materials.parameters import (
    LARGEST_MODULUS,
    TUNING,
    Function,
    Keywords,
    check_constants,
    check_keywords,
    check_size,
    check_value,
    constants_of,
    default_variants,
    moduli_or_defaults,
    shape_parameters,
    variants,
)
from fem_snh.materials.registry import (
    built_in,
    function,
    label,
    names_in_literature,
    pins,
    published,
)

#: Largest rest stress [E] of a user's energy: above the rounding errors of its parameters.
REST_STRESS = 1e-9
#: Three different stretches; permuting them must not change the value of an isotropic energy.
_STRETCHES = dict(
    zip(SIGMA, (sympy.Rational(9, 8), sympy.Rational(1), sympy.Rational(4, 5)), strict=True)
)


def make_energy(
    material: str | Function, E: float | None = None, nu: float | None = None, **keywords: Any
) -> Energy:
    """Return the energy of a material, normalised to (E, nu).

    Parameters
    ----------
    material : str or callable
        A name of `names`, a reference ``FILE.py:FUNCTION``, or a function.
    E : float, optional
        Young's modulus [Pa]. By default, the constants among the keywords determine E; without
        constants it is 1.
    nu : float, optional
        Poisson's ratio. By default, the constants determine nu; without constants it is 0.49.
    **keywords : Any
        Shape parameters (`defaults`), constants [Pa] (`pins`), constants of the literature
        (`published`) and the keywords of every material (`TUNING`): ``alpha``, ``alpha_mu``,
        ``alpha_lambda``, ``lambda_part``, ``epsilon``.

    Raises
    ------
    BadInput
        For an unknown name or keyword, E outside [1e-100, 1e100], nu outside (-1, 0.5], a function
        that does not return an energy, constants that cannot be fitted, or a user's energy that
        is stressed at rest or not isotropic.
    """
    found, name = function(material), label(material)
    own, pinned = shape_parameters(found), pins(material)
    literature = names_in_literature(material)
    known = [*own, *pinned, *literature, *TUNING]
    for key in keywords:
        if key not in known:
            raise BadInput(
                f"material '{name}' has no parameter '{key}'{suggestion_for(key, known)}: "
                f"it takes E, nu, {', '.join(known)}"
            )
    if any(keywords.get(key) is not None for key in (*pinned, *literature)):
        try:
            E, nu, keywords = with_moduli(material, E, nu, keywords)
        except Incomplete:
            # One of E and nu is given beside a prescribed constant; the other has its default.
            if (E is None and nu is None) or any(keywords.get(k) is not None for k in literature):
                raise
    E, nu = check_constants(*moduli_or_defaults(E, nu))
    check_keywords(found, keywords)
    other = keywords.get("lambda_part")
    if not (other is None or callable(other) or isinstance(other, str)):
        raise bad_value("lambda_part", other, "the name of a material")
    tuned = {k: v for k, v in keywords.items() if k in TUNING}
    if other is not None:
        tuned["lambda_part"] = label(other)
    shape = own | {k: v for k, v in keywords.items() if k in own}
    shape |= default_variants(found, nu, shape)
    energy = construct(
        found,
        name,
        E=E,
        nu=nu,
        shape=shape,
        pins={k: v for k, v in keywords.items() if k in pinned and v is not None},
        tuned=tuned,
        lambda_part=None if other is None else make_energy(other, E, nu),
    )
    equations = [v.equations[shape[key]] for key, v in variants(found).items()]
    energy = replace(energy, equation=", ".join(equations))
    if not (isinstance(material, str) and material in built_in()):
        _check_isotropy(energy)
        _check_rest_stress(energy)
    return energy


def _check_rest_stress(energy: Energy) -> None:
    """Raise BadInput if a user's energy is stressed at F = I: no choice of constants removes it."""
    stress = energy.rest_stress
    if not abs(stress) <= REST_STRESS * energy.E:
        raise BadInput(
            f"material '{energy.name}': stress {stress / energy.E:.3g} E at rest (F = I): expected "
            "an energy whose derivative vanishes there, e.g. with a term - mu log(J) or "
            "- mu (J - 1)"
        )


def _check_isotropy(energy: Energy) -> None:
    """Raise BadInput if a user's energy or stresses single out one of the principal stretches."""
    if not energy.of_stretches:
        return
    expressions = energy.expressions
    constants = dict(zip(energy.constants, energy.values, strict=True))

    def value(expression: sympy.Expr) -> float:
        return float(expression.subs(_STRETCHES).subs(constants))

    for order in ((1, 0, 2), (0, 2, 1)):
        swap = {SIGMA[i]: SIGMA[k] for i, k in enumerate(order)}
        # A stress of the swapped stretches is the swapped stress.
        expected = [expressions[k] for k in order] if energy.psi is None else expressions
        for expression, same in zip(expressions, expected, strict=True):
            swapped = expression.subs(swap, simultaneous=True)
            if abs(value(swapped) - value(same)) > REST_STRESS * energy.E:
                wanted = "p1 to be p0 with s0 and s1 swapped" if energy.psi is None else ""
                raise BadInput(
                    f"material '{energy.name}' is not symmetric in s0, s1, s2: expected "
                    f"{wanted or 'an isotropic energy'}"
                )


#: Largest relative difference of two equal values of E, and largest difference of two equal
#: Poisson's ratios: the rounding error of the ten digits that the error message shows.
_SAME = 1e-9


class Incomplete(BadInput):
    """The given constants do not determine E and nu."""


def with_moduli(
    material: str | Function, E: float | None, nu: float | None, given: Keywords
) -> tuple[float, float, dict[str, Any]]:
    """Return E and nu, computed from the constants if necessary, and the remaining keywords.

    Parameters
    ----------
    material : str or callable
        As for `fem_snh.materials.make_energy`.
    E : float or None
        Young's modulus [Pa], if given.
    nu : float or None
        Poisson's ratio, if given.
    given : mapping
        The other keywords.

    Returns
    -------
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    keywords : dict
        ``given`` with the material's own constants in place of published ones, and without
        constants that now follow from E and nu.

    Raises
    ------
    Incomplete
        If E and nu are not determined.
    BadInput
        For constants that contradict each other or E and nu.
    """
    own = function(material)
    keywords = _translated(material, given)
    constants = constants_of(own)
    pins = {c: keywords[c] for c in constants if keywords.get(c) is not None}
    if E is not None and nu is not None and len(pins) < len(constants):
        return E, nu, keywords  # `Normalisation` checks the constants against E and nu
    symbols, moduli = _moduli(own, label(material), nu, keywords)
    values = {symbols[c]: sympy.oo if v == math.inf else sympy.Rational(v) for c, v in pins.items()}
    mu, lam = (m.subs(values) for m in moduli)
    bulk = sympy.simplify(lam + mu * 2 / 3)
    named = {*constants, *names_in_literature(material)}
    words = [f"{k} = {_short(v)}" for k, v in given.items() if k in named and v is not None]
    what = f"material '{label(material)}' with {', '.join(words)}"
    found = _solve(what, mu, bulk, E, nu)
    if found is None:
        names = ", ".join(names_in_literature(material))
        raise Incomplete(
            f"{what} is incomplete: it takes E, nu, or its constants {', '.join(constants)}"
            f"{f' ({names})' if names else ''}, of which one may be E or nu"
        )
    free = determined(moduli, [symbols[c] for c in pins])
    return *found, {k: v for k, v in keywords.items() if symbols.get(k) not in free}


def drop_determined_moduli(
    table: dict[str, Any], given: Collection[str], keywords: Keywords
) -> dict[str, Any]:
    """Return a material's table without the old E and nu that newly given constants determine.

    Parameters
    ----------
    table : dict
        The material's ``name``, E, nu and keywords.
    given : collection of str
        The keys with new values. E or nu is kept if it is among them.
    keywords : mapping
        The entries of ``table`` that are keywords of this material.

    Raises
    ------
    Incomplete
        If E and nu would not be determined, whichever of them is left out.
    """
    name, own = table["name"], function(table["name"])
    groups = [set(p.meanings) for p in published(name)]
    together = set(given).union(*(names for names in groups if names & set(given)))
    new = _translated(name, {k: v for k, v in keywords.items() if k in together})
    symbols, (mu, _) = _moduli(own, label(name), table.get("nu"), {**keywords, **new})
    of_shear = any(symbols.get(c) in mu.free_symbols for c in new)
    choices = ({"E", "nu"}, {"E"}) if of_shear else ({"E", "nu"}, {"nu"}, {"E"}, set[str]())
    error: Incomplete | None = None
    for dropped in choices:
        left = {k: table.get(k) for k in ("E", "nu") if k in given or k not in dropped}
        try:
            with_moduli(name, left.get("E"), left.get("nu"), keywords)
        except Incomplete as reason:
            error = error or reason
            continue
        return {k: v for k, v in table.items() if k not in ("E", "nu") or k in left}
    assert error is not None
    raise error


def _translated(material: str | Function, given: Keywords) -> dict[str, Any]:
    """Return keywords with published constants replaced by the material's own keywords.

    Raises Incomplete if constants that belong together are not all given.
    """
    keywords = dict(given)
    for constants in published(material):
        names = list(constants.meanings)
        values = [keywords.pop(name, None) for name in names]
        if all(v is None for v in values):
            continue
        missing = [n for n, v in zip(names, values, strict=True) if v is None]
        if missing:
            raise Incomplete(
                f"material '{label(material)}': expected {missing[0]} beside "
                f"{', '.join(n for n in names if n not in missing)}"
            )
        values = [check_value(n, v, constants.kind) for n, v in zip(names, values, strict=True)]
        for name, value in zip(names, values, strict=True):
            check_size(name, value, LARGEST_MODULUS)
        for key, value in constants.own(*values).items():
            if keywords.get(key) is not None:
                raise BadInput(
                    f"material '{label(material)}': {key} and {', '.join(names)}: expected one of "
                    "the two"
                )
            keywords[key] = value
    return keywords


def _moduli(
    own: Function, name: str, nu: float | None, keywords: Keywords
) -> tuple[dict[str, sympy.Symbol], Pair]:
    """Return the symbol of each constant by name, and (mu_lame, lambda_lame) in these symbols."""
    shape = shape_parameters(own)
    known = {k: v for k, v in keywords.items() if k in shape or k in constants_of(own)}
    finite = {k: v for k, v in known.items() if v != math.inf}
    check_keywords(own, finite)
    shape |= {k: v for k, v in known.items() if k in shape}
    if nu is None and "nu" in signature(own).parameters:
        raise Incomplete(f"material '{name}': its energy depends on nu: expected nu = a number")
    form = symbolic(own, name, nu, shape)
    return {str(c): c for c in form.constants}, form.moduli


def _solve(
    what: str, mu: sympy.Expr, bulk: sympy.Expr, E: float | None, nu: float | None
) -> tuple[float, float] | None:
    """Return (E [Pa], nu) from two of mu, the bulk modulus, E and nu; None if two are not known.

    ``mu`` and ``bulk`` are known if they are numbers. Raises BadInput, which begins with ``what``,
    for a modulus that is not positive or contradicts E or nu.
    """
    if mu.is_number and not mu > 0:
        raise BadInput(f"{what} has the shear modulus {float(mu):g} Pa: expected one above 0")
    if bulk.is_number and not bulk > 0:
        raise BadInput(f"{what} has the bulk modulus {float(bulk):g} Pa: expected one above 0")
    if mu.is_number and bulk.is_number:
        ratio = mu / bulk
        found = float(9 * mu / (3 + ratio)), float((3 - 2 * ratio) / (6 + 2 * ratio))
    elif mu.is_number and nu is not None:
        found = float(2 * mu * (1 + sympy.Rational(nu))), nu
    elif mu.is_number and E is not None:
        found = E, float(sympy.Rational(E) / (2 * mu) - 1)
    elif bulk.is_number and E is not None:
        found = E, float(sympy.Rational(1, 2) - sympy.Rational(E) / (6 * bulk))
    elif bulk.is_number and nu is not None and bulk != sympy.oo:
        found = float(3 * bulk * (1 - 2 * sympy.Rational(nu))), nu
    else:
        return None
    for key, mine, theirs, size in (("E", E, found[0], found[0]), ("nu", nu, found[1], 1.0)):
        if mine is not None and abs(mine - theirs) > _SAME * size:
            raise BadInput(
                f"{what} has no free constant and {key} = {theirs:.10g}, not {mine:g}: expected "
                f"that {key}, or none"
            )
    return found


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else shown(value)
