"""Read test data: stretches and nominal stresses of homogeneous deformations.

A file has lines of numbers with commas, semicolons, tabs or blanks between. A line of column names
may stand above them, with units in brackets, and comment lines ``# key = value``::

    # test = uniaxial
    stretch, stress [MPa]
    1.12, 0.14

A column ``test`` gives each line its own test, so that one file may contain several.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput, bad_value, choose, nearest_file, shown
from fem_snh.files import read_text
from fem_snh.units import stress_unit

Array = npt.NDArray[np.float64]

#: Names of the tests, and other names that files may use for them.
TESTS = {
    "uniaxial": ("tension", "compression", "ut", "simple_tension"),
    "equibiaxial": ("biaxial", "et", "eb"),
    "planar": ("pure_shear", "ps", "planar_tension"),
    "simple_shear": ("shear", "ss"),
    "volumetric": ("hydrostatic", "bulk"),
    "confined": ("oedometric", "uniaxial_strain"),
}
#: Names of the columns, and other names that files may use for them.
COLUMNS = {
    "stretch": ("lambda", "λ", "stretch_ratio", "s"),
    "strain": ("engineering_strain", "nominal_strain", "eps", "epsilon", "ε"),
    "shear": ("gamma", "γ", "amount_of_shear", "shear_strain"),
    "volume_ratio": ("j", "v/v0"),
    "stress": ("nominal_stress", "engineering_stress", "pk1", "p", "shear_stress", "force/area"),
    "pressure": ("hydrostatic_pressure",),
    "test": ("kind", "mode"),
    "weight": (),
}
#: Built-in data, by name.
DATASETS = {file.stem: file for file in sorted(Path(__file__).parent.glob("tables/*.csv"))}
#: Columns that measure the deformation, and those that measure the stress.
_DEFORMATIONS, _STRESSES = ("stretch", "strain", "shear", "volume_ratio"), ("stress", "pressure")
#: What a column is in the messages of a file without it.
_DEFORMATION_WORDS = "stretch or strain (shear of simple_shear, volume_ratio of volumetric)"
_COMMENT = re.compile(r"#+\s*(test|unit|weight|columns)\s*[=:]\s*(.+?)\s*$", re.IGNORECASE)
_COLUMN = re.compile(r"^(?P<name>[^\[\(]*?)\s*[\[\(]\s*(?P<unit>[^\]\)]*)[\]\)]\s*$")
#: Units of a column that has none.
_NO_UNIT = ("", "-", "1", "mm/mm", "m/m")


@dataclass(frozen=True)
class TestData:
    """The measured points of one test.

    Attributes
    ----------
    name : str
        The file and the test, for messages and pictures.
    kind : str
        Key of `TESTS`.
    x : (n,)
        Stretch in the direction of the test; amount of shear of ``simple_shear``. A volumetric
        test has the same stretch in all directions.
    stress : (n,)
        Nominal stress, force per area at rest [Pa, or the file's unit if it states none]; P_01 of
        ``simple_shear``.
    weight : (n,)
        Weights of the residuals.
    """

    __test__ = False  # the name is not one of a test of pytest's

    name: str
    kind: str
    x: Array
    stress: Array
    weight: Array

    @property
    def rest(self) -> float:
        """Return the x of the state at rest."""
        return 0.0 if self.kind == "simple_shear" else 1.0


def read(
    path: str | Path,
    test: str | None = None,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    weight: float | None = None,
    modulus_unit: str | None = None,
) -> list[TestData]:
    """Return the tests in a file, in the order of their first lines.

    Parameters
    ----------
    path : str or Path
        The file, or the name of one of `DATASETS`.
    test, columns, unit, weight : optional
        Kind of test, names of the columns, unit of the stress and weight of the residuals; they
        replace those that the file states. Columns with other names are not used.
    modulus_unit : str, optional
        Unit in which the stresses are returned; default: Pa, or that of the file if none is stated.

    Raises
    ------
    BadInput
        For everything that is wrong in the file.
    """
    path = Path(path)
    stated, rows = read_cells(path)
    given = {"test": test, "unit": unit, "weight": weight}
    stated |= {key: str(value) for key, value in given.items() if value is not None}
    names = columns
    if names is None and "columns" in stated:
        names = _cells(stated["columns"])
    header = any(not is_number(cell) and cell.lower() not in _kinds() for cell in rows[0][1])
    if header:
        names = names or rows[0][1]
        rows = rows[1:]
    if names is None:
        raise BadInput(
            f"{path}: no line of column names above the numbers: expected one, e.g. "
            "'stretch, stress [MPa]', or --columns stretch,stress"
        )
    return _tests(path, stated, _columns(path, names), rows, modulus_unit)


def read_cells(path: Path) -> tuple[dict[str, str], list[tuple[int, list[str]]]]:
    """Return what the comments of a file state, and the number and the cells of each other line.

    Raises BadInput for a file that cannot be read, and for one without such lines.
    """
    built_in = DATASETS.get(str(path)) if not path.exists() else None
    try:
        text = read_text(built_in or path, encoding="utf-8-sig")
    except FileNotFoundError:
        raise BadInput(f"data = '{path}': no such file{nearest_file(path)}") from None
    except UnicodeDecodeError:
        raise BadInput(f"data = '{path}': expected a text file with columns of numbers") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"data = '{path}': {reason}") from None
    stated, rows = _lines(text)
    if not rows:
        raise BadInput(f"{path}: no line of numbers: expected columns of numbers")
    return stated, rows


def _lines(text: str) -> tuple[dict[str, str], list[tuple[int, list[str]]]]:
    """Return what the comments state, and the number and the cells of the other lines."""
    stated: dict[str, str] = {}
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip().startswith("#"):
            if found := _COMMENT.match(line.strip()):
                stated[found[1].lower()] = found[2]
        elif line.strip():
            rows.append((number, _cells(line)))
    return stated, rows


def _cells(line: str) -> list[str]:
    """Return the cells of a line; blanks separate them if no comma, semicolon or tab does."""
    for separator in (";", "\t", ","):
        if separator in line:
            return [cell.strip() for cell in line.strip().strip(separator).split(separator)]
    return line.split()


def _kinds() -> dict[str, str]:
    """Return the kind of test of each accepted name."""
    return {name: kind for kind, others in TESTS.items() for name in (kind, *others)}


def _columns(path: Path, cells: Sequence[str]) -> dict[str, tuple[int, str]]:
    """Return the position and the unit of each known column."""
    known = {name: column for column, others in COLUMNS.items() for name in (column, *others)}
    found: dict[str, tuple[int, str]] = {}
    for position, cell in enumerate(cells):
        split = _COLUMN.match(cell.strip().strip('"'))
        name, unit = (split["name"], split["unit"]) if split else (cell.strip().strip('"'), "")
        word = re.sub(r"[\s_]+", "_", name.strip().lower())
        if word in ("true_stress", "cauchy_stress", "cauchy"):
            raise BadInput(
                f"{path}: column '{cell}': expected the nominal stress, force per area at rest"
            )
        if word not in known:
            continue
        if known[word] in found:
            raise BadInput(f"{path}: column '{cell}': expected one column {known[word]}")
        found[known[word]] = (position, unit.strip())
    for group, words in ((_DEFORMATIONS, _DEFORMATION_WORDS), (_STRESSES, "stress or pressure")):
        if sum(column in found for column in group) != 1:
            raise BadInput(
                f"{path}: columns = {shown(', '.join(cells))}: expected one column {words}"
            )
    return found


def _tests(
    path: Path,
    stated: dict[str, str],
    columns: dict[str, tuple[int, str]],
    rows: list[tuple[int, list[str]]],
    modulus_unit: str | None,
) -> list[TestData]:
    """Return the tests of a file's lines."""
    deformation = next(c for c in _DEFORMATIONS if c in columns)
    measure = next(c for c in _STRESSES if c in columns)
    unit = stated.get("unit") or columns[measure][1]
    size = stress_unit(f"{path}: unit", unit) if unit not in _NO_UNIT else 1.0
    if modulus_unit is not None:
        size /= stress_unit("modulus_unit", modulus_unit)
        if unit in _NO_UNIT:
            accepted = "data whose stresses have a unit: stress [MPa], or --unit"
            raise bad_value("modulus_unit", modulus_unit, f"{accepted}; {path} states none")
    percent = columns[deformation][1] == "%"
    if not percent and columns[deformation][1] not in _NO_UNIT:
        raise bad_value(f"{path}: unit of {deformation}", columns[deformation][1], "none or %")
    default = _kind(path, stated["test"]) if "test" in stated else None
    if default is None and "test" not in columns:
        default = {"shear": "simple_shear", "volume_ratio": "volumetric"}.get(deformation)
    if default is None and "test" not in columns:
        raise BadInput(
            f"{path}: no test: expected a line '# test = {'|'.join(TESTS)}', a column test, or "
            "--test"
        )
    overall = _number(path, 0, stated.get("weight", "1"), "weight")
    if not overall > 0:
        raise bad_value(f"{path}: weight", stated["weight"], "a number > 0")
    points: dict[str, list[tuple[float, float, float]]] = {}
    for number, cells in rows:
        if len(cells) <= max(position for position, _ in columns.values()):
            raise BadInput(
                f"{path}: line {number}: {len(cells)} values: expected {len(columns)} or more, "
                f"with {', '.join(columns)}"
            )
        kind = default or _kind(path, cells[columns["test"][0]], number)
        x = _number(path, number, cells[columns[deformation][0]], deformation)
        y = _number(path, number, cells[columns[measure][0]], measure) * size
        weight = overall
        if "weight" in columns:
            weight *= _number(path, number, cells[columns["weight"][0]], "weight")
            if not weight >= 0:
                raise bad_value(f"{path}: line {number}: weight", weight, "a number >= 0")
        points.setdefault(kind, []).append(
            _point(path, number, kind, deformation, measure, x / 100 if percent else x, y, weight)
        )
    several = len(points) > 1
    return [_checked(path, kind, several, np.array(found)) for kind, found in points.items()]


def _kind(path: Path, text: str, line: int = 0) -> str:
    """Return the kind of test that a file names."""
    word = re.sub(r"[\s_-]+", "_", text.strip().strip('"').lower())
    key = f"{path}: line {line}: test" if line else f"{path}: test"
    return choose(key, _kinds().get(word, word), list(TESTS))


def _point(
    path: Path,
    line: int,
    kind: str,
    deformation: str,
    measure: str,
    x: float,
    y: float,
    weight: float,
) -> tuple[float, float, float]:
    """Return (stretch or shear, nominal stress, weight) of one line."""
    where = f"{path}: line {line}: {deformation}"
    if (deformation == "shear" and kind != "simple_shear") or (
        deformation == "volume_ratio" and kind != "volumetric"
    ):
        raise BadInput(f"{where} in a test '{kind}': expected stretch or strain")
    if measure == "pressure" and kind not in ("volumetric", "confined"):
        raise BadInput(f"{path}: line {line}: pressure in a test '{kind}': expected stress")
    if kind == "simple_shear":
        if deformation == "stretch":
            raise BadInput(f"{where} in a test '{kind}': expected the amount of shear")
        return x, y, weight
    stretch = 1 + x if deformation == "strain" else x
    if not stretch > 0:
        accepted = "a number > -1" if deformation == "strain" else "a number > 0"
        raise bad_value(where, x, accepted)
    if deformation == "volume_ratio":
        stretch = stretch ** (1 / 3)
    if measure == "pressure":  # positive in compression, per deformed area
        y = -y * (stretch**2 if kind == "volumetric" else 1.0)
    return stretch, y, weight


def _checked(path: Path, kind: str, several: bool, points: Array) -> TestData:
    """Return the test of (n, 3) points; raise BadInput where they cannot be a measurement."""
    x, stress, weight = points.T
    name = f"{path.stem} {kind}" if several else path.stem
    found = TestData(name, kind, x, stress, weight)
    moved = np.abs(x - found.rest) > 0
    if not moved.any() or not stress.any():
        raise BadInput(f"{path}: test '{kind}': expected a deformation and a stress other than 0")
    work = stress[moved] * (x[moved] - found.rest)
    if (work <= 0).all():
        raise BadInput(
            f"{path}: test '{kind}': every stress has the wrong sign: expected tension and "
            "stretches above 1 with stresses above 0, compression with stresses below 0"
        )
    return found


def is_number(text: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(path: Path, line: int, text: str | float, what: str) -> float:
    """Return a finite number of a file."""
    where = f"{path}: line {line}: {what}" if line else f"{path}: {what}"
    try:
        number = float(text)
    except ValueError:
        raise bad_value(where, text, "a number, with a decimal point") from None
    if not np.isfinite(number):
        raise bad_value(where, number, "a finite number")
    return number
