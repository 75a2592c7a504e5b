"""Hyperelastic energies: one energy, one small file, one function, written once.

A material is a module of ``models/`` with a function of the same name::

    def neo_hookean(I_C, J, mu, lam):
        return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2

Its arguments say what it is: the deformation measures it needs (``I1, I_C, II_C, J``, or the
stretches ``s0, s1, s2``), then its free constants, then, keyword only, its shape parameters with
their defaults (and ``nu`` if it wants to know). ``_functions.py`` has what it may use besides
sympy's own: pieces, barriers, stresses without an energy. The function receives and returns sympy
expressions; the UFL forms, the C kernels, the numpy values and the 50-digit oracle of the tests are
all made from that one expression (`fem_snh.materials.energy.Energy`). `TUNING` is what can be done
to any of them.
"""

from __future__ import annotations

import inspect
import pkgutil
import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

from fem_snh.errors import BadInput, choose, nearest
from fem_snh.materials import models
from fem_snh.materials.energy import Energy
from fem_snh.materials.signature import constants_of, shape_parameters
from fem_snh.materials.tuning import TUNING

__all__ = ["TUNING", "Energy", "defaults", "describe", "energy", "names", "pins"]


def names() -> list[str]:
    """The sorted names of all materials, found by scanning ``models/``."""
    found = (m.name for m in pkgutil.iter_modules(models.__path__))
    return sorted(name for name in found if name[0] != "_")


def function(name: str) -> Callable[..., Any]:
    """The function that defines material ``name``. Raises BadInput for an unknown name."""
    choose("material", name, names())
    found: Callable[..., Any] = getattr(import_module(f"{models.__name__}.{name}"), name)
    return found


def defaults(name: str) -> dict[str, Any]:
    """The shape parameters of material ``name`` with their default values."""
    return shape_parameters(function(name))


def describe(name: str) -> str:
    """The docstring of material ``name``: its equation, source and parameters."""
    return inspect.getdoc(function(name)) or ""


def pins(name: str) -> list[str]:
    """The free constants of material ``name`` that a user may pin [Pa]: if there are over two."""
    constants = constants_of(function(name))
    return list(constants) if len(constants) > 2 else []


def energy(name: str, E: float = 1.0, nu: float = 0.49, **keywords: Any) -> Energy:
    """The energy called ``name``, normalised to Young's modulus E [Pa] and Poisson's ratio nu.

    Keywords are its own shape parameters (`defaults`), its free constants where it has more than
    two (`pins`), and what every material takes (`TUNING`): ``alpha``, ``alpha_mu``,
    ``alpha_lambda``, ``lambda_part``, ``epsilon``.

    Raises BadInput for an unknown name or keyword, E <= 0, nu outside (-1, 0.5], or constants that
    cannot be fitted.
    """
    own, pinned = defaults(name), pins(name)
    known = [*own, *pinned, *TUNING]
    for key in keywords:
        if key not in known:
            raise BadInput(
                f"material '{name}' has no parameter '{key}'{nearest(key, known)}: "
                f"it takes E, nu, {', '.join(known)}"
            )
    other = keywords.get("lambda_part")
    return Energy(
        function(name),
        E=E,
        nu=nu,
        shape=own | {k: v for k, v in keywords.items() if k in own},
        pins={k: v for k, v in keywords.items() if k in pinned and v is not None},
        tuned={k: v for k, v in keywords.items() if k in TUNING},
        lambda_part=None if other is None else energy(other, E, nu),
    )


class _Callable(ModuleType):
    """`fem_snh.materials` is a package, and `fem_snh.materials()` its list of names."""

    def __call__(self) -> list[str]:
        return names()


sys.modules[__name__].__class__ = _Callable
