"""Find the function of a material by its name or reference, and make its energy."""

from __future__ import annotations

import inspect
import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Any

import sympy

from fem_snh.errors import BadInput, choose, nearest
from fem_snh.materials import models
from fem_snh.materials.construction import construct
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA
from fem_snh.materials.normalise import LARGEST_MODULUS
from fem_snh.materials.signature import (
    LARGEST_PARAMETER,
    Function,
    check_signature,
    check_size,
    constants_of,
    measures_of,
    shape_parameters,
)
from fem_snh.materials.tuning import TUNING
from fem_snh.references import entry_points, is_reference, load_reference

#: The entry point group of packages that provide materials: name -> function.
GROUP = "fem_snh.materials"

#: Largest rest stress [E] of a user's energy: above the rounding errors of its parameters.
REST_STRESS = 1e-9
#: Three different stretches, at which an isotropic energy may not depend on their order.
_STRETCHES = dict(
    zip(SIGMA, (sympy.Rational(9, 8), sympy.Rational(1), sympy.Rational(4, 5)), strict=True)
)
_RESERVED = {"name", "E", "group", "density", *TUNING}


class Reference(str):
    """A reference ``FILE.py:FUNCTION`` whose file is relative to ``folder``.

    It is a string, equal to the reference as the user wrote it. In a plain string of this form the
    file is relative to the working directory.
    """

    folder: Path

    def __new__(cls, text: str, folder: Path | str = "") -> Reference:
        made = super().__new__(cls, text)
        made.folder = Path(folder)
        return made

    def __reduce__(self) -> tuple[Any, ...]:  # sent from rank to rank
        return Reference, (str(self), self.folder)


def built_in() -> list[str]:
    """Return the sorted names of the materials in ``models/``."""
    found = (m.name for m in pkgutil.iter_modules(models.__path__))
    return sorted(name for name in found if name[0] != "_")


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
            own = load_reference(str(material), getattr(material, "folder", None))
        except BadInput as error:
            reason = str(error).removeprefix(f"'{material}': ")
            raise BadInput(f"material = '{material}': {reason}") from None
    else:
        points = entry_points(GROUP)
        choose("material", material, names())
        own = points[material]()
    check_signature(own, label(material), _RESERVED)
    return own


def files(*materials: Any) -> list[Path]:
    """Return the files of those materials that are references ``FILE.py:FUNCTION``."""
    given = [m for m in materials if isinstance(m, str) and is_reference(m)]
    return [getattr(m, "folder", Path()) / m.rpartition(":")[0] for m in given]


def defaults(material: str | Function) -> dict[str, Any]:
    """Return the shape parameters of a material with their default values."""
    return shape_parameters(function(material))


def describe(material: str | Function) -> str:
    """Return the docstring of a material's function; without one, its arguments."""
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
    """Return the constants of a material that may be prescribed [Pa], if it has more than two."""
    constants = constants_of(function(material))
    return list(constants) if len(constants) > 2 else []


def make_energy(
    material: str | Function, E: float = 1.0, nu: float = 0.49, **keywords: Any
) -> Energy:
    """Return the energy of a material, normalised to (E, nu).

    Parameters
    ----------
    material : str or callable
        A name of `names`, a reference ``FILE.py:FUNCTION``, or a function.
    E, nu : float
        Young's modulus [Pa] and Poisson's ratio.
    **keywords : Any
        Shape parameters (`defaults`), prescribed constants [Pa] (`pins`) and the keywords of every
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
    known = [*own, *pinned, *TUNING]
    for key in keywords:
        if key not in known:
            raise BadInput(
                f"material '{name}' has no parameter '{key}'{nearest(key, known)}: "
                f"it takes E, nu, {', '.join(known)}"
            )
    other = keywords.get("lambda_part")
    tuned = {k: v for k, v in keywords.items() if k in TUNING}
    if other is not None:
        tuned["lambda_part"] = label(other)
    for key in {**own, **dict.fromkeys(pinned)}:
        if key in keywords:
            check_size(key, keywords[key], LARGEST_MODULUS if key in pinned else LARGEST_PARAMETER)
    energy = construct(
        found,
        name,
        E=E,
        nu=nu,
        shape=own | {k: v for k, v in keywords.items() if k in own},
        pins={k: v for k, v in keywords.items() if k in pinned and v is not None},
        tuned=tuned,
        lambda_part=None if other is None else make_energy(other, E, nu),
    )
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
