"""Constants under the names of the literature and of other programs: C10, D1, mu_p, alpha_p."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fem_snh.errors import bad_value

#: Type of a list of numbers.
LIST = tuple[float, ...]


@dataclass(frozen=True)
class Published:
    """Published constants, from which some of a material's own keywords follow.

    Attributes
    ----------
    meanings : mapping
        What each constant is, by name.
    own : callable
        Returns values of the material's own keywords; the arguments are the values of the
        published constants, in their order.
    kind : type
        The type of their values, `float` or `LIST`.
    """

    meanings: Mapping[str, str]
    own: Callable[..., dict[str, Any]]
    kind: Any = float


def renamed(name: str, own: str, meaning: str) -> Published:
    """Return a constant that the material has under another name."""
    return Published({name: f"{meaning}; `{own}` under its usual name."}, lambda c: {own: c})


def bulk(own: str) -> Published:
    """Return D1 of Abaqus and others, the compliance of the volume term (J - 1)^2/D1.

    Parameters
    ----------
    own : str
        The material's bulk modulus, of the volume term own/2 (J - 1)^2.
    """
    meaning = f"Compliance of the volume term (J - 1)^2/D1 [1/Pa]: {own} = 2/D1; 0 is nu = 0.5."

    def modulus(D1: float) -> dict[str, float]:
        if not D1 >= 0:
            raise bad_value("D1", D1, "a number >= 0")
        return {own: 2 / D1 if D1 else math.inf}

    return Published({"D1": meaning}, modulus)
