"""Hyperelastic energy densities, each written once as one function.

A built-in material is a module of ``models/`` with a function of the same name::

    def neo_hookean(I_C, J, mu, lam):
        return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2

The arguments define the material: first the deformation measures (``I1, I_C, II_C, J``, or the
stretches ``s0, s1, s2``), then its free constants, then, keyword only, its shape parameters with
their defaults, and ``nu`` if the energy depends on it. The function receives and returns sympy
expressions. It may use sympy's log, exp and sqrt, and from this package `where` (piecewise
energies), `positive` (barriers) and `PrincipalStress` (a stress without an energy). The C kernels,
the UFL forms and the numpy values are all generated from that one expression, the
`fem_snh.materials.energy.Energy`.

A user's material is given in one of three ways: as the function itself
(``fem_snh.material(gent, E=1e4, nu=0.45)``), as a reference ``"gent.py:gent"``, or as the name of
an entry point in the group ``fem_snh.materials`` of an installed package. A user's material is
normalised, tuned, mixed and compiled like a built-in one. `fem_snh.materials.parameters.TUNING`
lists the keywords of every material.

`fem_snh.materials()` returns the sorted names.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from fem_snh.materials.parameters import TUNING
from fem_snh.materials.registry import (
    defaults,
    describe,
    files,
    function,
    label,
    names,
    names_in_literature,
    pins,
)

if TYPE_CHECKING:
    from fem_snh.materials.energy import Energy
    from fem_snh.materials.invariants import PrincipalStress, positive, where
    from fem_snh.materials.making import make_energy

__all__ = [
    "TUNING", "Energy", "PrincipalStress", "defaults", "describe", "files",
    "function", "label", "make_energy", "names", "names_in_literature", "pins", "positive",
    "where",
]  # fmt: skip


#: The module of each public name that needs sympy; it is imported when the name is first used.
_MODULES = {
    "Energy": "energy",
    "PrincipalStress": "invariants",
    "positive": "invariants",
    "where": "invariants",
    "make_energy": "making",
}


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names, including names that are not imported yet."""
    return list(__all__)


class _CallableModule(ModuleType):
    """A package that returns its list of names when called: ``fem_snh.materials()``."""

    def __call__(self) -> list[str]:
        return names()


sys.modules[__name__].__class__ = _CallableModule
