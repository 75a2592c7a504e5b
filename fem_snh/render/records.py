"""Names and Poisson's ratios of the materials in run.json, for titles and legends."""

from __future__ import annotations

from typing import Any


def materials(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the entries of a run's materials in run.json: one, or several with their groups."""
    found = record["material"]
    return found if isinstance(found, list) else [found]


def material_name(record: dict[str, Any]) -> str:
    """Return the names of the materials, each once."""
    return " + ".join(dict.fromkeys(pretty(str(m["name"])) for m in materials(record)))


def poisson_ratio(record: dict[str, Any]) -> str:
    """Return Poisson's ratio as text; several materials have each value once, in their order."""
    return ", ".join(dict.fromkeys(f"{m['nu']:g}" for m in materials(record)))


def pretty(name: str) -> str:
    """Return the name of a material for a label: "stable Neo-Hookean"."""
    return name.replace("neo_hookean", "Neo-Hookean").replace("_", " ")
