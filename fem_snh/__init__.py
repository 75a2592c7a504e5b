"""Stable Neo-Hookean flesh simulation in FEniCSx.

    >>> import fem_snh
    >>> m = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)  # at any F (..., 3, 3)
    >>> m.hessian(F, filter="clamp")  # (..., 9, 9), never indefinite
    >>> print(m.report())  # what this energy is like
    >>> result = fem_snh.run("twist", cells=15, out="out/twist")  # under MPI, too

One way through: `materials` (an energy, written once) -> `kernels` (its C, eight points at a time)
-> `forms` (its UFL) -> `problem` (mesh, element, conditions) -> `solver` (projected Newton, a
PETSc SNES) -> `runs` (load steps, output) -> `studies`, `cli`. Beside it, `reports` (what an energy
is like) and `modes` (eigenfrequencies).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fem_snh.errors import BadInput

if TYPE_CHECKING:
    from fem_snh.kernels.pointwise import material
    from fem_snh.runs import Result, run

__all__ = ["BadInput", "Result", "material", "materials", "run"]

# Loaded when first asked for: a typing mistake on the command line need not wait for dolfinx.
_WHERE = {"material": "kernels.pointwise", "run": "runs", "Result": "runs"}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "materials":
        return import_module(f"{__name__}.materials")
    if name in _WHERE:
        return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
