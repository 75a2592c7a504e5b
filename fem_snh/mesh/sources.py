"""What the built-in sources of meshes say of themselves: bounds of their parameters."""

from __future__ import annotations

import re
from functools import cache
from typing import NamedTuple

from fem_snh.mesh.gmsh_input import source_path


class SourceParameter(NamedTuple):
    """A parameter of a source.

    Attributes
    ----------
    default, least, step : float
        Its default, its least value, and what its values are multiples of.
    """

    default: float
    least: float
    step: float


@cache
def parameter(source: str, name: str) -> SourceParameter | None:
    """Return a parameter in the DefineConstant of meshes/<source>.geo; None without it."""
    found = re.search(rf"^  {name} = {{([^,]+),([^}}]*)", _text(source), re.MULTILINE)
    if not found:
        return None
    default, rest = found.groups()
    bounds = dict(re.findall(r"(Min|Step) ([-+.\d]+)", rest))
    return SourceParameter(
        float(default), float(bounds.get("Min", 0)), float(bounds.get("Step", 1))
    )


@cache
def has_free_sizes(source: str, dim: int) -> bool:
    """Return whether a field may give the sizes of the cells: they are in no rows or layers."""
    text = _text(source)
    return "Transfinite" not in text and not (dim == 3 and "Layers" in text)


def _text(source: str) -> str:
    return source_path(source).read_text(encoding="utf-8")
