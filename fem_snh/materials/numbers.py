"""The numbers of an energy: all that a solve with compiled kernels needs of it.

The numbers of built-in materials are stored in the cache, so that a solve does not need sympy: the
import of sympy and the fit of the constants take longer than a small solve.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fem_snh import cache

if TYPE_CHECKING:
    from fem_snh.materials.energy import Energy
    from fem_snh.materials.parameters import Keywords

_MODELS = Path(__file__).with_name("models")


@dataclass(frozen=True)
class Numbers:
    """The numbers of an energy.

    Attributes
    ----------
    name : str
        The material's name.
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    shape : dict
        Values of the shape parameters and of the given tuning keywords, by name.
    constants : tuple of str
        Names of the material's own constants, e.g. ("mu", "lam").
    values : tuple of float
        Values of ``constants`` [Pa].
    lame : tuple of float
        (mu_lame, lambda_lame) [Pa], linearised from the energy.
    has_energy : bool
        Whether the stress is the gradient of an energy.
    equation : str
        The variant, e.g. "eq. 14 of Smith et al. 2018"; "" for a material without variants.
    key : str or None
        The key of these numbers in the cache; None for a user's material.
    """

    name: str
    E: float
    nu: float
    shape: dict[str, Any]
    constants: tuple[str, ...]
    values: tuple[float, ...]
    lame: tuple[float, float]
    has_energy: bool
    equation: str = ""
    key: str | None = None

    @property
    def incompressible(self) -> bool:
        """Return True at nu = 0.5, which requires mixed elements."""
        return self.nu == 0.5


def numbers_of(energy: Energy, key: str | None = None) -> Numbers:
    """Return the numbers of an energy; ``key`` is their key in the cache."""
    taken = {each.name: getattr(energy, each.name) for each in fields(Numbers)[:-1]}
    return Numbers(**taken | {"constants": tuple(map(str, energy.constants))}, key=key)


def stored_key(
    material: object, E: float | None, nu: float | None, keywords: Keywords
) -> str | None:
    """Return the cache key of the numbers; None for users' materials and invalid arguments."""
    names = [material, *filter(None, [keywords.get("lambda_part")])]
    if not all(type(name) is str and _is_own(name) for name in names):
        return None
    try:
        given = {k: float(v) if type(v) is int else v for k, v in keywords.items()}
        moduli = [None if v is None else float(v) for v in (E, nu)]
        return cache.key(cache.sources("materials"), material, *moduli, given)
    except (TypeError, ValueError, OverflowError):  # `make_energy` reports what is wrong
        return None


def _is_own(name: str) -> bool:
    """Return whether ``name`` is a module of ``models/``, whose source `cache.sources` hashes."""
    return name.isidentifier() and (_MODELS / f"{name}.py").is_file()


def stored(
    material: object, E: float | None = None, nu: float | None = None, /, **keywords: Any
) -> Numbers | None:
    """Return the cached numbers of a material with these arguments; None if there are none.

    Parameters
    ----------
    material, E, nu, **keywords
        As for `fem_snh.materials.make_energy`. Arguments with stored numbers are valid.
    """
    key = stored_key(material, E, nu, keywords)
    record = cache.read(key) if key else None
    if record is None:
        return None
    record |= {name: tuple(record[name]) for name in ("constants", "values", "lame")}
    record["shape"] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in record["shape"].items()
    }
    return Numbers(**record, key=key)


def store(numbers: Numbers) -> None:
    """Write the numbers of a material to the cache, unless their key is None."""
    if numbers.key:
        record = asdict(numbers)
        del record["key"]
        cache.write(numbers.key, record)
