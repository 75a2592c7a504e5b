"""Check the numbers and the keywords that a user gives a material."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import formatannotation, signature
from numbers import Real
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from fem_snh.errors import bad_value
from fem_snh.materials.keywords import LARGEST_MODULUS, TUNING, Accepted, Variant

T = TypeVar("T")

#: What Young's modulus and Poisson's ratio are, and the numbers that are accepted.
_CONSTANTS = {
    "E": (
        1 / LARGEST_MODULUS,
        LARGEST_MODULUS,
        f"a number from {1 / LARGEST_MODULUS:g} to {LARGEST_MODULUS:g} (Young's modulus [Pa])",
    ),
    "nu": (-1.0, 0.5, "a number in (-1, 0.5] (Poisson's ratio)"),
}
#: The types of keywords in words: of one value, and of those of a list.
_WORDS = {
    float: ("a finite number", "finite numbers"),
    int: ("a whole number", "whole numbers"),
    str: ("a text", "texts"),
    bool: ("true or false", "true or false"),
}


def check_constants(E: Any, nu: Any) -> tuple[float, float]:
    """Return Young's modulus [Pa] and Poisson's ratio as floats.

    Raises
    ------
    BadInput
        Unless E is a number in [1e-100, 1e100] and nu one in (-1, 0.5]. True and False are none.
    """
    found = []
    for key, value in (("E", E), ("nu", nu)):
        low, high, accepted = _CONSTANTS[key]
        number = plain(value)
        if not isinstance(number, int | float) or isinstance(number, bool):
            raise bad_value(key, value, accepted)
        if not low <= number <= high or (key == "nu" and number == low):
            raise bad_value(
                key, number if abs(number) > LARGEST_MODULUS else float(number), accepted
            )
        found.append(float(number))
    return found[0], found[1]


def moduli_or_defaults(E: Any, nu: Any) -> tuple[Any, Any]:
    """Return Young's modulus [Pa] and Poisson's ratio; 1 and 0.49 for None."""
    return 1.0 if E is None else E, 0.49 if nu is None else nu


def check_keywords(function: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of keywords of a material's function, which have the types it states.

    Parameters
    ----------
    function : callable
        The material function. Without an annotation the type is that of the default value, of a
        whole number any number.
    given : mapping
        Values of its shape parameters, of its constants and of the `TUNING` keywords.

    Raises
    ------
    BadInput
        For a value of another type, true and false are no numbers, and one outside its `Accepted`.
    """
    kinds, limits = _kinds(function), ranges(function)
    found = {key: check_value(key, value, kinds.get(key, Any)) for key, value in given.items()}
    for key, value in found.items():
        if key in limits and value not in limits[key]:
            raise bad_value(key, given[key], limits[key].accepted)
    return found


def ranges(function: Callable[..., Any]) -> dict[str, Accepted]:
    """Return the accepted values of the parameters that a material's function annotates."""
    return _annotations(function, Accepted)


def variants(function: Callable[..., Any]) -> dict[str, Variant]:
    """Return the variants of the parameters that a material's function annotates."""
    return _annotations(function, Variant)


def default_variants(
    function: Callable[..., Any], nu: float, given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the parameters that select a variant and are not among the given, at a ratio nu."""
    found = variants(function)
    return {key: v.default(nu) for key, v in found.items() if given.get(key) is None}


def _annotations(function: Callable[..., Any], kind: type[T]) -> dict[str, T]:
    """Return the annotations of one kind, by parameter."""
    try:
        hints = get_type_hints(function, include_extras=True)
    except (NameError, TypeError, AttributeError, SyntaxError):
        return {}
    metadata = {key: getattr(hint, "__metadata__", ()) for key, hint in hints.items()}
    return {k: r for k, found in metadata.items() for r in found if isinstance(r, kind)}


def plain(value: Any) -> Any:
    """Return lists, the only sequences of TOML, as tuples, and numpy's values as Python's."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(plain(v) for v in value) if isinstance(value, list | tuple) else value


def _kinds(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the types of the keywords of a material's function."""
    found: dict[str, Any] = {key: float | None for key in TUNING if key != "lambda_part"}
    found["lambda_part"] = Any  # a name or a function
    try:
        hints = get_type_hints(function)
    except (NameError, TypeError, AttributeError, SyntaxError):
        hints = {}
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


def check_value(key: str, value: Any, kind: Any) -> Any:
    """Return ``value`` as type ``kind``, a whole number as a float; otherwise raise BadInput."""
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


def _described(kind: Any) -> str:
    """Return a type in words. None, which stands for the default, is not mentioned."""
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
