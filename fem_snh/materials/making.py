"""Make the energy of a material from its name, (E, nu) and keywords."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import sympy

from fem_snh.errors import BadInput, bad_value, nearest
from fem_snh.materials.construction import construct
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA
from fem_snh.materials.keywords import LARGEST_MODULUS, LARGEST_PARAMETER, TUNING
from fem_snh.materials.native import Incomplete, with_moduli
from fem_snh.materials.parameters import (
    check_constants,
    check_keywords,
    default_variants,
    moduli_or_defaults,
    variants,
)
from fem_snh.materials.registry import (
    built_in,
    function,
    label,
    names_in_literature,
    pins,
)
from fem_snh.materials.signature import Function, check_size, shape_parameters

#: Largest rest stress [E] of a user's energy: above the rounding errors of its parameters.
REST_STRESS = 1e-9
#: Three different stretches, at which an isotropic energy may not depend on their order.
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
    E, nu : float, optional
        Young's modulus [Pa] and Poisson's ratio; by default those of the constants among the
        keywords, without these 1 and 0.49.
    **keywords : Any
        Shape parameters (`defaults`), constants [Pa] (`pins`), those of the literature
        (`published`) and the keywords of every
        material (`TUNING`): ``alpha``, ``alpha_mu``, ``alpha_lambda``, ``lambda_part``,
        ``epsilon``.

    Raises
    ------
    BadInput
        For an unknown name or keyword, E <= 0, nu outside (-1, 0.5], a function that does not
        return an energy, constants that cannot be fitted, or a function of the user's own that is
        stressed at rest or not isotropic.
    """
    found, name = function(material), label(material)
    own, pinned = shape_parameters(found), pins(material)
    literature = names_in_literature(material)
    known = [*own, *pinned, *literature, *TUNING]
    for key in keywords:
        if key not in known:
            raise BadInput(
                f"material '{name}' has no parameter '{key}'{nearest(key, known)}: "
                f"it takes E, nu, {', '.join(known)}"
            )
    if any(keywords.get(key) is not None for key in (*pinned, *literature)):
        try:
            E, nu, keywords = with_moduli(material, E, nu, keywords)
        except Incomplete:
            # A constant prescribed beside E or nu, of which the other has its default.
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
    for key in {**own, **dict.fromkeys(pinned)}:
        if key in keywords:
            check_size(key, keywords[key], LARGEST_MODULUS if key in pinned else LARGEST_PARAMETER)
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
    """Raise BadInput if a user's energy in the stretches depends on their order."""
    if not energy.of_stretches or energy.psi is None:
        return
    s0, s1, s2 = SIGMA
    first = energy.psi.subs(_STRETCHES)
    for order in ((s1, s0, s2), (s0, s2, s1)):
        swapped = energy.psi.subs(dict(zip(SIGMA, order, strict=True)), simultaneous=True)
        difference = (swapped.subs(_STRETCHES) - first).subs(
            dict(zip(energy.constants, energy.values, strict=True))
        )
        if abs(float(difference)) > REST_STRESS * energy.E:
            raise BadInput(
                f"material '{energy.name}' is not symmetric in s0, s1, s2: expected an isotropic "
                "energy"
            )
