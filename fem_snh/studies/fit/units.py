"""Units of stress that files of test data may state."""

from __future__ import annotations

from fem_snh.errors import choose

#: Units of stress, and their sizes [Pa].
STRESS_UNITS = {
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "GPa": 1e9,
    "N/m^2": 1.0,
    "N/mm^2": 1e6,
    "bar": 1e5,
    "psi": 6894.757293168361,  # lbf/in^2: 4.4482216152605 N / (0.0254 m)^2
    "kgf/cm^2": 98066.5,
    "kg/cm^2": 98066.5,
}
#: Other spellings of units.
_SPELLINGS = {"²": "^2", "**2": "^2", "cm2": "cm^2", "mm2": "mm^2", "m2": "m^2"}


def stress_unit(key: str, text: str) -> float:
    """Return the size of a unit of stress [Pa]; raise BadInput for an unknown one."""
    unit = text.strip()
    for other, ours in _SPELLINGS.items():
        if unit.endswith(other) and not unit.endswith(ours):
            unit = unit.removesuffix(other) + ours
    by_case = {name.lower(): name for name in STRESS_UNITS if name.lower() != "mpa"}
    return STRESS_UNITS[choose(key, by_case.get(unit.lower(), unit), list(STRESS_UNITS))]
