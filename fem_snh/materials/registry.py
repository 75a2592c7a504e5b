"""Find the function of a material by its name or reference.

`Published` describes constants under the names of the literature and of other programs: C10, D1,
mu_p.
"""

from __future__ import annotations

import inspect
import math
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput, bad_value, choose
from fem_snh.materials import models
from fem_snh.materials.parameters import (
    TUNING,
    Function,
    check_signature,
    constants_of,
    measures_of,
    shape_parameters,
)
from fem_snh.references import entry_points, file_of, folder_of, is_reference, load_reference

#: The type of a `Published` constant that is a list of numbers.
LIST = tuple[float, ...]


@dataclass(frozen=True)
class Published:
    """Published constants, from which some of a material's own keywords follow.

    Attributes
    ----------
    meanings : mapping
        The meaning of each constant, by name.
    own : callable
        Returns values of the material's own keywords by name. The arguments are the values of the
        published constants, in the order of ``meanings``.
    kind : type
        The type of the constants' values, `float` or `LIST`.
    """

    meanings: Mapping[str, str]
    own: Callable[..., dict[str, Any]]
    kind: type = float


def renamed(name: str, own: str, meaning: str) -> Published:
    """Return the `Published` constant ``name`` that the material calls ``own``."""
    return Published({name: f"{meaning}; `{own}` under its usual name."}, lambda c: {own: c})


def bulk(own: str) -> Published:
    """Return the constant D1 of Abaqus and others, the compliance in (J - 1)^2/D1.

    Parameters
    ----------
    own : str
        Name of the bulk modulus in the material's volume term own/2 (J - 1)^2.
    """
    meaning = f"Compliance of the volume term (J - 1)^2/D1 [1/Pa]: {own} = 2/D1; 0 is nu = 0.5."

    def modulus(D1: float) -> dict[str, float]:
        if not D1 >= 0:
            raise bad_value("D1", D1, "a number >= 0")
        return {own: 2 / D1 if D1 else math.inf}

    return Published({"D1": meaning}, modulus)


#: The entry point group of packages that provide materials: name -> function.
GROUP = "fem_snh.materials"

_RESERVED = {"name", "E", "group", "density", *TUNING}


def built_in() -> tuple[str, ...]:
    """Return the sorted names of the materials in ``models/``."""
    return _modules(tuple(models.__path__))


@cache
def _modules(folders: tuple[str, ...]) -> tuple[str, ...]:
    """Return the sorted names of the modules in ``folders`` that do not begin with "_"."""
    found = (m.name for m in pkgutil.iter_modules(folders))
    return tuple(sorted(name for name in found if name[0] != "_"))


def names() -> list[str]:
    """Return the sorted names of all materials: those of ``models/`` and of entry points.

    A built-in material takes precedence over an entry point of the same name.
    """
    return sorted({*built_in(), *entry_points(GROUP)})


def label(material: str | Function) -> str:
    """Return the name of a material: the given text, or the name of the function."""
    if isinstance(material, str):
        return str(material)
    return str(getattr(material, "__name__", type(material).__name__))


def function(material: str | Function) -> Function:
    """Return the function that defines a material.

    Parameters
    ----------
    material : str or callable
        A name of `names`, a reference ``FILE.py:FUNCTION``, or the function itself.

    Raises
    ------
    BadInput
        For an unknown name, a reference that cannot be loaded, or a function whose arguments do
        not define a material.
    """
    if isinstance(material, str) and material in built_in():
        found: Function = getattr(import_module(f"{models.__name__}.{material}"), material)
        return found
    if not isinstance(material, str):
        own = material
        if not callable(own):
            raise BadInput(f"material = {material!r}: expected a name or a function")
    elif is_reference(material):
        try:
            own = load_reference(material)
        except BadInput as error:
            reason = str(error).removeprefix(f"'{material}': ")
            raise BadInput(f"material = '{material}': {reason}") from None
    else:
        points = entry_points(GROUP)
        choose("material", material, names())
        own = points[material]()
    check_signature(own, label(material), _RESERVED)
    return own


def files(*materials: object) -> list[Path]:
    """Return the file of each material that is a reference ``FILE.py:FUNCTION``."""
    given = [m for m in materials if isinstance(m, str) and is_reference(m)]
    return [folder_of(m) / file_of(m) for m in given]


def defaults(material: str | Function) -> dict[str, Any]:
    """Return the shape parameters of a material with their default values."""
    return shape_parameters(function(material))


def describe(material: str | Function) -> str:
    """Return the docstring of a material's function; without a docstring, list its arguments."""
    found = function(material)
    if text := inspect.getdoc(found):
        return text.replace("\n::\n\n", "\n")  # the mark-up of a literal block
    lines = [f"{label(material)}: a function without a docstring", ""]
    for what, given in (
        ("measures", measures_of(found)),
        ("constants", list(constants_of(found))),
        ("shape parameters", [f"{k} = {v!r}" for k, v in shape_parameters(found).items()]),
    ):
        lines.append(f"{what}: {', '.join(given) or 'none'}")
    return "\n".join(lines)


def pins(material: str | Function) -> list[str]:
    """Return the names of the constants [Pa] of a material that may be prescribed.

    If the energy depends on nu and has at most two constants, none may: they would determine nu.
    """
    constants = constants_of(found := function(material))
    depends_on_nu = "nu" in inspect.signature(found).parameters
    return [] if depends_on_nu and len(constants) <= 2 else list(constants)


def names_in_literature(material: str | Function) -> list[str]:
    """Return the names of the `published` constants that a material accepts."""
    return [name for constants in published(material) for name in constants.meanings]


def published(material: str | Function) -> tuple[Published, ...]:
    """Return the published constants of a built-in material; () for a user's material."""
    if not (isinstance(material, str) and material in built_in()):
        return ()
    module = import_module(f"{models.__name__}.{material}")
    return tuple(getattr(module, "PUBLISHED", ()))
