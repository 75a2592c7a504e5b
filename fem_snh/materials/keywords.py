"""The keywords of every material, and the limits of its numbers.

Scenes are checked against them without sympy, which takes longer to import than a small solve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fem_snh.errors import bad_value

#: Largest modulus [Pa], and the inverse of the smallest: the squares in a norm stay finite.
LARGEST_MODULUS = 1e100
#: Largest shape parameter: its products with stretches and moduli stay finite.
LARGEST_PARAMETER = 1e6
#: Largest exponent: the generated C has one multiplication for each unit, and sympy would expand
#: 9**9**9.
MAX_EXPONENT = 64
#: The b of lambda_local (`fem_snh.materials.volume_split`), by the element's volume treatment.
#: A small b favours the linear solver of a saddle-point problem, a large b strong compression
#: (measured in docs/results/elements.md).
BOUNDS = {"mean": 4.0, "cell_pressure": 4.0, "pressure": 2.0}
#: Keywords of every material, with their defaults.
TUNING: dict[str, float | str | None] = {
    "alpha": 1.0,
    "alpha_mu": None,
    "alpha_lambda": None,
    "lambda_part": None,
    "epsilon": None,
}
#: What each of them is.
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
class Accepted:
    """The accepted values of a shape parameter, as an annotation of it.

    Attributes
    ----------
    accepted : str
        The values in words.
    low, high : float
        The ends.
    above, below : bool
        Whether a value has to be above the lower and below the upper end.
    nonzero : bool
        Whether 0 is not accepted.
    """

    accepted: str
    low: float = -LARGEST_PARAMETER
    high: float = LARGEST_PARAMETER
    above: bool = False
    below: bool = False
    nonzero: bool = False

    def __contains__(self, value: float) -> bool:
        """Return whether a value is accepted."""
        low = value > self.low if self.above else value >= self.low
        high = value < self.high if self.below else value <= self.high
        return low and high and not (self.nonzero and value == 0)


@dataclass(frozen=True)
class Variant:
    """The equations between which a shape parameter selects, as an annotation of it.

    Attributes
    ----------
    default : callable
        Returns the value for a Poisson's ratio, where the parameter is None.
    equations : mapping
        The equation of each value, with its source.
    """

    default: Callable[[float], Any]
    equations: Mapping[Any, str]


#: Accepted exponents of the power strains.
EXPONENTS = Accepted(
    f"a number from {-MAX_EXPONENT} to {MAX_EXPONENT}, not 0: that limit is 'hencky'",
    -MAX_EXPONENT,
    MAX_EXPONENT,
    nonzero=True,
)


def check(tuning: dict[str, Any]) -> dict[str, Any]:
    """Return the values of all `TUNING` keywords; the alphas of the parts default to ``alpha``.

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
