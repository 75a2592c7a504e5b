"""Hyperelastic energies: one energy, one small file, one function, written once.

A material is a module of this folder with a function of the same name::

    def neo_hookean(I_C, J, mu, lam):
        return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2

Its arguments say what it is: the deformation measures it needs (``I1, I_C, II_C, J``, or the
stretches ``s0, s1, s2``), then its free constants, then, keyword only, its shape parameters with
their defaults (and ``nu`` if it wants to know). The function receives and returns sympy
expressions; the UFL forms, the C kernels, the numpy values and the 50-digit oracle of the tests are
all made from that one expression (`fem_snh.materials.energy.Energy`).
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
from fem_snh.materials.energy import Energy, shape_parameters

__all__ = ["Energy", "defaults", "describe", "energy", "names"]

_NOT_MATERIALS = {"energy", "invariants"}


def names() -> list[str]:
    """The sorted names of all materials, found by scanning this folder."""
    return sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name not in _NOT_MATERIALS)


def function(name: str) -> Callable[..., Any]:
    """The function that defines material ``name``. Raises BadInput for an unknown name."""
    choose("material", name, names())
    found: Callable[..., Any] = getattr(import_module(f"{__name__}.{name}"), name)
    return found


def defaults(name: str) -> dict[str, Any]:
    """The shape parameters of material ``name`` with their default values."""
    return shape_parameters(function(name))


def describe(name: str) -> str:
    """The docstring of material ``name``: its equation, source and parameters."""
    return inspect.getdoc(function(name)) or ""


def energy(name: str, E: float = 1.0, nu: float = 0.49, **shape: Any) -> Energy:
    """The energy called ``name``, normalised to Young's modulus E [Pa] and Poisson's ratio nu.

    Raises BadInput for an unknown name or shape parameter, E <= 0, or nu outside (-1, 0.5).
    """
    known = defaults(name)
    for key in shape:
        if key not in known:
            accepted = ", ".join(known) if known else "none"
            raise BadInput(
                f"material '{name}' has no parameter '{key}'{nearest(key, known)}: "
                f"it takes E, nu and {accepted}"
            )
    return Energy(function(name), E=E, nu=nu, shape=known | shape)


class _Callable(ModuleType):
    """`fem_snh.materials` is a package, and `fem_snh.materials()` its list of names."""

    def __call__(self) -> list[str]:
        return names()


sys.modules[__name__].__class__ = _Callable
