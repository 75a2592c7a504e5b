"""What a material's function says of its material by its parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from fem_snh.materials.invariants import MEASURES


def shape_parameters(function: Callable[..., Any]) -> dict[str, Any]:
    """The keyword-only arguments of a material function with their defaults; ``nu`` is no shape."""
    return {
        name: parameter.default
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name != "nu"
    }


def constants_of(function: Callable[..., Any]) -> dict[str, float | None]:
    """The free constants of a material function and their defaults [units of E], or None."""
    return {
        name: None if parameter.default is parameter.empty else parameter.default
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is parameter.POSITIONAL_OR_KEYWORD and name not in MEASURES
    }
