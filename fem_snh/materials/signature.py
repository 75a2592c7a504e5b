"""Read a material from the signature of its function: measures, constants, shape parameters."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

from fem_snh.errors import BadInput, bad_value

Function = Callable[..., Any]

#: Names of the deformation measures that may be arguments (`fem_snh.materials.invariants`).
MEASURES = ("I1", "I_C", "II_C", "J", "s0", "s1", "s2")

#: The accepted measures, for messages.
ACCEPTED = "I_C (tr C), II_C, J (det F), I1 (sum of the stretches), s0, s1, s2 (the stretches)"
#: Names that the literature uses for deformation measures, which a constant must not have.
#: I_1, I4, I_Q, IIIC, I1bar, J_bar, F, C, B, sigma_0, lambda_1, ...
_OTHER_MEASURE = re.compile(
    r"I[I_]*\w{0,2}(_?bar)?|J_?bar|[FCBjs]|s3|s_[012]|sigma_?[012]?|lambda_?[123]|stretch(es)?"
)


def measures_of(function: Function) -> list[str]:
    """Return the names of the deformation measures among a material function's arguments."""
    parameters = inspect.signature(function).parameters
    return [n for n, p in parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD and n in MEASURES]


def shape_parameters(function: Function) -> dict[str, Any]:
    """Return the keyword-only arguments of a material function, without ``nu``, and defaults."""
    return {
        name: parameter.default
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name != "nu"
    }


def constants_of(function: Function) -> dict[str, float | None]:
    """Return the free constants of a material function, with defaults [units of E] or None."""
    return {
        name: None if parameter.default is parameter.empty else parameter.default
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is parameter.POSITIONAL_OR_KEYWORD and name not in MEASURES
    }


def check_size(key: str, value: Any, largest: float) -> None:
    """Raise BadInput if a number, or one of a sequence, is not in [-largest, largest]."""
    for number in value if isinstance(value, tuple | list) else (value,):
        if isinstance(number, int | float) and not abs(number) <= largest:
            what = "numbers" if isinstance(value, tuple | list) else "a number"
            raise bad_value(key, value, f"{what} from {-largest:g} to {largest:g}")


def check_signature(function: Function, name: str, reserved: set[str]) -> None:
    """Raise BadInput unless the arguments of a user's function define a material.

    Parameters
    ----------
    function : callable
        The material function.
    name : str
        The material, for messages.
    reserved : set of str
        Keywords of every material.
    """
    try:
        parameters = inspect.signature(function).parameters
    except (TypeError, ValueError):
        raise BadInput(f"material '{name}': expected a Python function of {ACCEPTED}") from None
    for key, p in parameters.items():
        if p.kind not in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY):
            raise BadInput(
                f"material '{name}': argument '{key}': expected measures, constants and, after *, "
                "shape parameters by name"
            )
        constant = p.kind is p.POSITIONAL_OR_KEYWORD and key not in MEASURES
        if constant and _OTHER_MEASURE.fullmatch(key):
            raise BadInput(
                f"material '{name}': argument '{key}': expected a measure among {ACCEPTED}, or a "
                "constant with another name"
            )
        if constant and set(list(parameters)[list(parameters).index(key) :]) & set(MEASURES):
            raise BadInput(
                f"material '{name}': argument '{key}': expected a measure among {ACCEPTED}; the "
                "constants follow the measures"
            )
        if key in reserved:
            raise BadInput(
                f"material '{name}': argument '{key}': expected another name; every material has "
                f"the keyword {key}"
            )
        if p.kind is p.KEYWORD_ONLY and key != "nu" and p.default is p.empty:
            raise BadInput(f"material '{name}': shape parameter '{key}': expected a default value")
        if p.kind is p.POSITIONAL_OR_KEYWORD and key == "nu":
            raise BadInput(f"material '{name}': argument 'nu': expected after *, as a keyword")
    if not measures_of(function):
        raise BadInput(f"material '{name}': expected an argument that is a measure: {ACCEPTED}")
