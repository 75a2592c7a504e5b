"""Read the parameters of a material from its function's signature, and check their values.

The module also defines the keywords of every material and the limits of numbers. It does not
import sympy, whose import takes longer than a small solve: scenes are checked without sympy.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import formatannotation, signature
from numbers import Real
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from fem_snh.errors import BadInput, Range, bad_value

#: A material's function.
Function = Callable[..., Any]
#: Values of a material's keywords, by name.
Keywords = Mapping[str, Any]
#: Largest modulus [Pa], and the inverse of the smallest: the squares in a norm stay finite.
LARGEST_MODULUS = 1e100
#: Largest shape parameter: its products with stretches and moduli stay finite.
LARGEST_PARAMETER = 1e6
#: Largest exponent: the generated C has one multiplication for each unit, and sympy would expand
#: 9**9**9.
MAX_EXPONENT = 64
#: The b of lambda_local (`fem_snh.materials.volume_split`), by the element's volume treatment.
#: A small b helps the linear solver of a saddle-point problem, a large b helps under strong
#: compression (measured in docs/results/elements.md).
BOUNDS = {"mean": 4.0, "cell_pressure": 4.0, "pressure": 2.0}
#: Keywords of every material, with their defaults.
TUNING: dict[str, float | str | None] = {
    "alpha": 1.0,
    "alpha_mu": None,
    "alpha_lambda": None,
    "lambda_part": None,
    "epsilon": None,
}
#: The meaning of each `TUNING` keyword.
MEANINGS = {
    "alpha": "nonlinearity: the same material at small strain, stiffer (above 1) or softer at "
    "large stretch (Chen & Barbič)",
    "alpha_mu": "alpha of the part of mu alone",
    "alpha_lambda": "alpha of the part of lambda alone",
    "lambda_part": "name of the material whose part of lambda replaces its own",
    "epsilon": "stretch below which the nonlinearity is extended so that it survives inversion",
}
#: Accepted alpha: s^alpha increases with s, and s^(4 alpha) has at most the largest exponent of
#: generated code.
ALPHAS = (0.01, MAX_EXPONENT / 4)
#: Accepted epsilon, besides 0: the rest state s = 1 is outside the extension, and 1 + epsilon^4
#: differs from 1 in double precision.
EPSILONS = (1e-4, 0.99)


@dataclass(frozen=True)
class Variant:
    """Annotation of a shape parameter that selects between published equations.

    Attributes
    ----------
    default : callable
        Returns, from Poisson's ratio, the value that the default None stands for.
    equations : mapping
        The equation that each value selects, with its source.
    """

    default: Callable[[float], object]
    equations: Mapping[object, str]


#: Accepted exponents of the power strains.
EXPONENTS = Range(
    -MAX_EXPONENT,
    MAX_EXPONENT,
    nonzero=True,
    words=f"a number from {-MAX_EXPONENT} to {MAX_EXPONENT}, not 0: that limit is 'hencky'",
)


def check(tuning: dict[str, Any]) -> dict[str, Any]:
    """Return all `TUNING` keywords; ``alpha_mu`` and ``alpha_lambda`` default to ``alpha``.

    None in ``tuning`` means the default.

    Raises
    ------
    BadInput
        For an alpha outside `ALPHAS` or an epsilon outside `EPSILONS`.
    """
    given = TUNING | {k: v for k, v in tuning.items() if v is not None}
    for key in ("alpha_mu", "alpha_lambda"):
        given[key] = given["alpha"] if given[key] is None else given[key]
    for key in ("alpha", "alpha_mu", "alpha_lambda", "epsilon"):
        value = given[key]
        if value is None or (key == "epsilon" and value == 0 and not isinstance(value, bool)):
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool)
        low, high = EPSILONS if key == "epsilon" else ALPHAS
        if not (number and low <= value <= high):
            zero = "0 or " if key == "epsilon" else ""
            raise bad_value(key, value, f"{zero}a number from {low:g} to {high:g}")
    return given


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
    parameters = signature(function).parameters
    return [n for n, p in parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD and n in MEASURES]


def shape_parameters(function: Function) -> dict[str, Any]:
    """Return the defaults of a material function's keyword-only arguments except ``nu``."""
    return {
        name: parameter.default
        for name, parameter in signature(function).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name != "nu"
    }


def constants_of(function: Function) -> dict[str, float | None]:
    """Return the constants among a material function's arguments, each with its default [E].

    None means that a constant has no default.
    """
    return {
        name: None if parameter.default is parameter.empty else parameter.default
        for name, parameter in signature(function).parameters.items()
        if parameter.kind is parameter.POSITIONAL_OR_KEYWORD and name not in MEASURES
    }


def check_size(key: str, value: object, largest: float) -> None:
    """Raise BadInput if ``value``, or an item of it, is a number not in [-largest, largest]."""
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
        Names that no argument may have: keywords of every material.
    """
    try:
        parameters = signature(function).parameters
    except (TypeError, ValueError):
        raise BadInput(f"material '{name}': expected a Python function of {ACCEPTED}") from None

    def mistake(key: str, expected: str) -> BadInput:
        return BadInput(f"material '{name}': argument '{key}': expected {expected}")

    keys, measure = list(parameters), f"a measure among {ACCEPTED}"
    for position, (key, p) in enumerate(parameters.items()):
        if p.kind not in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY):
            raise mistake(key, "measures, constants and, after *, shape parameters by name")
        constant = p.kind is p.POSITIONAL_OR_KEYWORD and key not in MEASURES
        if constant and _OTHER_MEASURE.fullmatch(key):
            raise mistake(key, f"{measure}, or a constant with another name")
        if constant and set(keys[position:]) & set(MEASURES):
            raise mistake(key, f"{measure}; the constants follow the measures")
        if key in reserved:
            raise mistake(key, f"another name; every material has the keyword {key}")
        if p.kind is p.KEYWORD_ONLY and key != "nu" and p.default is p.empty:
            raise BadInput(f"material '{name}': shape parameter '{key}': expected a default value")
        if p.kind is p.POSITIONAL_OR_KEYWORD and key == "nu":
            raise mistake(key, "after *, as a keyword")
    if not measures_of(function):
        raise BadInput(f"material '{name}': expected an argument that is a measure: {ACCEPTED}")


T = TypeVar("T")

#: The accepted values of Young's modulus [Pa] and Poisson's ratio.
_MODULI = 1 / LARGEST_MODULUS, LARGEST_MODULUS
_CONSTANTS = {
    "E": Range(
        *_MODULI, words="a number from {:g} to {:g} (Young's modulus [Pa])".format(*_MODULI)
    ),
    "nu": Range(-1.0, 0.5, open_low=True, words="a number in (-1, 0.5] (Poisson's ratio)"),
}
#: Each type of a keyword in words, for one value and for the items of a list.
_WORDS = {
    float: ("a finite number", "finite numbers"),
    int: ("a whole number", "whole numbers"),
    str: ("a text", "texts"),
    bool: ("true or false", "true or false"),
}


def check_constants(E: object, nu: object) -> tuple[float, float]:
    """Return Young's modulus [Pa] and Poisson's ratio as floats.

    Raises
    ------
    BadInput
        Unless E is a number in [1e-100, 1e100] and nu a number in (-1, 0.5]. True and False are not
        accepted as numbers.
    """
    found = []
    for key, value in (("E", E), ("nu", nu)):
        accepted, number = _CONSTANTS[key], plain(value)
        if not isinstance(number, int | float) or isinstance(number, bool):
            raise bad_value(key, value, str(accepted))
        if number not in accepted:
            given = number if abs(number) > LARGEST_MODULUS else float(number)
            raise bad_value(key, given, str(accepted))
        found.append(float(number))
    return found[0], found[1]


def moduli_or_defaults(E: float | None, nu: float | None) -> tuple[float, float]:
    """Return (E [Pa], nu), with 1 in place of E = None and 0.49 in place of nu = None."""
    return 1.0 if E is None else E, 0.49 if nu is None else nu


def check_keywords(function: Function, given: Keywords) -> dict[str, Any]:
    """Return the keywords of a material's function, converted to the types that it declares.

    Parameters
    ----------
    function : callable
        The material function. A shape parameter without an annotation has the type of its default
        value; if that is a whole number, any number is accepted.
    given : mapping
        Values of shape parameters and constants of the function and of `TUNING` keywords.

    Raises
    ------
    BadInput
        For a value of another type, outside its `Range`, or of excessive size. True and False are
        not numbers.
    """
    kinds, limits = _kinds(function), ranges(function)
    found = {key: check_value(key, value, kinds.get(key, Any)) for key, value in given.items()}
    constants, shape = constants_of(function), shape_parameters(function)
    for key, value in found.items():
        if key in constants or key in shape:
            check_size(key, value, LARGEST_MODULUS if key in constants else LARGEST_PARAMETER)
        if key in limits and value not in limits[key]:
            raise bad_value(key, given[key], str(limits[key]))
    return found


def ranges(function: Function) -> dict[str, Range]:
    """Return the `Range` of each parameter that a material's function annotates with one."""
    return _annotations(function, Range)


def variants(function: Function) -> dict[str, Variant]:
    """Return the `Variant` of each parameter that a material's function annotates with one."""
    return _annotations(function, Variant)


def default_variants(function: Function, nu: float, given: Keywords) -> dict[str, object]:
    """Return, at Poisson's ratio nu, the default of each `Variant` parameter not in ``given``."""
    found = variants(function)
    return {key: v.default(nu) for key, v in found.items() if given.get(key) is None}


def _hints(function: Function, extras: bool = False) -> dict[str, Any]:
    """Return the annotations, ``Annotated`` ones with ``extras``; {} if they cannot be read."""
    try:
        return get_type_hints(function, include_extras=extras)
    except (NameError, TypeError, AttributeError, SyntaxError):
        return {}


def _annotations(function: Function, kind: type[T]) -> dict[str, T]:
    """Return the annotations of type ``kind`` by parameter."""
    hints = _hints(function, extras=True)
    metadata = {key: getattr(hint, "__metadata__", ()) for key, hint in hints.items()}
    return {k: r for k, found in metadata.items() for r in found if isinstance(r, kind)}


def plain(value: object) -> Any:
    """Return ``value`` with lists as tuples, and with numpy's numbers and arrays as Python's.

    Lists are the only sequences of TOML.
    """
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(plain(v) for v in value) if isinstance(value, list | tuple) else value


def _kinds(function: Function) -> dict[str, Any]:
    """Return the type that each keyword of a material's function must have."""
    found: dict[str, Any] = {key: float | None for key in TUNING if key != "lambda_part"}
    found["lambda_part"] = Any  # a name or a function
    hints = _hints(function)
    for name, parameter in signature(function).parameters.items():
        if parameter.kind is not parameter.KEYWORD_ONLY:
            found[name] = float | None  # a constant that is prescribed
        elif name in hints:
            found[name] = hints[name]
        elif isinstance(parameter.default, bool | str):
            found[name] = type(parameter.default)
        elif isinstance(parameter.default, Real):
            found[name] = float
    return found


def check_value(key: str, value: object, kind: Any) -> Any:
    """Return ``value`` as ``kind``, an int as a float if required; otherwise raise BadInput."""
    if kind is Any:
        return value
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    strict = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)
    given = plain(value)
    try:
        given = list(given) if get_origin(kind) is list and isinstance(given, tuple) else given
        return TypeAdapter(kind, config=strict).validate_python(given)
    except ValidationError:
        raise bad_value(key, value, _described(kind)) from None


def _described(kind: object) -> str:
    """Return a type in words. None, which means the default, is not mentioned."""
    if kind in _WORDS:
        return _WORDS[kind][0]
    origin, kinds = get_origin(kind), [part for part in get_args(kind) if part is not NoneType]
    if origin is Literal:
        return f"one of {', '.join(map(str, kinds))}"
    is_list = (origin is list and len(kinds) == 1) or (origin is tuple and kinds[1:] == [...])
    if is_list and kinds[0] in _WORDS:
        return f"a list of {_WORDS[kinds[0]][1]}"
    if origin in (Union, UnionType):
        return " or ".join(map(_described, kinds))
    return formatannotation(kind)
