"""Units of stress in files of test data, and units of a scene for the labels of pictures.

The program computes in any consistent units and converts nothing but test data.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from fem_snh.errors import BadInput, bad_value, choose

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
#: Units of length [m], force [N] and time [s].
_LENGTHS = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
_FORCES = {"N": 1.0, "kN": 1e3, "MN": 1e6, "mN": 1e-3, "uN": 1e-6, "kgf": 9.80665}
_FORCES["lbf"] = 4.4482216152605
_TIMES = {"s": 1.0, "ms": 1e-3}
#: Largest relative difference of two values of one unit: pounds and inches are rounded.
_SAME_SIZE = 1e-6
#: Other spellings of units.
_SPELLINGS = {"²": "^2", "**2": "^2", "cm2": "cm^2", "mm2": "mm^2", "m2": "m^2"}
#: Units of forces, moments, energies, volumes and momenta per thickness, for plane problems.
_PER_THICKNESS = {"N": "N/m", "N m": "N", "J": "N", "m^3": "m^2", "kg m/s": "N s/m"}
_PER_THICKNESS["kg m^2/s"] = "N s"
#: Derived units in terms of the units of length, force and time.
_DERIVED = {"J": "N m", "kg m/s": "N s", "kg m^2/s": "N m s"}


def volume_change(ratio: float) -> str:
    """Return the change of a volume in per cent: "+0.51" for the ratio 1.0051, "0.00" for 1."""
    text = f"{100 * (ratio - 1):+.2f}"
    return text if float(text) else "0.00"


def stress_unit(key: str, text: str) -> float:
    """Return the size of a unit of stress [Pa]; raise BadInput, with ``key``, if it is unknown."""
    unit = _spelled(text)
    by_case = {name.lower(): name for name in STRESS_UNITS if name.lower() != "mpa"}
    return STRESS_UNITS[choose(key, by_case.get(unit.lower(), unit), list(STRESS_UNITS))]


def _spelled(text: str) -> str:
    """Return a unit in the spelling of the tables above: "mm^2" for "mm²"."""
    unit = text.strip()
    for other, ours in _SPELLINGS.items():
        if unit.endswith(other) and not unit.endswith(ours):
            unit = unit.removesuffix(other) + ours
    return unit


@dataclass(frozen=True)
class Units:
    """The units of a scene, for labels.

    Attributes
    ----------
    length, force, stress, time : str
        Names of the units; the unit of stress is that of force over the square of that of length.
    in_plane : bool
        Whether forces, moments and energies are per thickness.
    """

    length: str = "m"
    force: str = "N"
    stress: str = "Pa"
    time: str = "s"
    in_plane: bool = False

    @classmethod
    def read(cls, text: str) -> Units:
        """Return the units of a text such as "mm, N, MPa", in any order; the time is s or ms.

        Raises
        ------
        BadInput
            For an unknown unit, one that is missing or named twice, or a stress that is not the
            force over the square of the length.
        """
        tables = {"length": _LENGTHS, "force": _FORCES, "stress": STRESS_UNITS, "time": _TIMES}
        known = {unit: kind for kind, table in tables.items() for unit in table}
        words = list(map(_spelled, text.split(",")))
        found = {known[word]: word for word in words if word in known}
        if len(found) != len(words) or not {"length", "force", "stress"} <= found.keys():
            accepted = "a unit of length, one of force, one of stress and perhaps one of time of "
            raise bad_value("units", text, f'{accepted}{", ".join(known)}, as "mm, N, MPa"')
        size = _FORCES[found["force"]] / _LENGTHS[found["length"]] ** 2
        if not math.isclose(STRESS_UNITS[found["stress"]], size, rel_tol=_SAME_SIZE):
            accepted = f"{found['force']} over {found['length']} squared as the unit of stress"
            raise bad_value("units", text, accepted)
        return cls(found["length"], found["force"], found["stress"], found.get("time", "s"))

    @classmethod
    def of(cls, record: dict[str, Any]) -> Units | None:
        """Return the units in the record of a run, its run.json; None if its scene states none."""
        if "units" not in record:
            return None
        try:
            found = cls.read(str(record["units"]))
        except BadInput as error:
            raise BadInput(f"run.json: {error}") from None
        flat = str(record.get("kinematics", "")).startswith("plane")
        return cls(found.length, found.force, found.stress, found.time, flat)

    def name(self, unit: str) -> str:
        """Return the unit that takes the place of an SI unit, such as "Pa" or "m/s^2"."""
        unit = _PER_THICKNESS.get(unit, unit) if self.in_plane else unit
        ours = {"m": self.length, "N": self.force, "Pa": self.stress, "s": self.time}
        is_si = (self.length, self.force, self.time) == ("m", "N", "s")
        words = unit if is_si else _DERIVED.get(unit, unit)
        return re.sub(r"[A-Za-z]+", lambda word: ours.get(word[0], word[0]), words)
