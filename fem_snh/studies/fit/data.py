"""Read test data: stretches and stresses of homogeneous deformations.

A file has lines of numbers with commas, semicolons, tabs or blanks between. A line of column names
may stand above them, with units in brackets, and a comment with the test::

    # test = uniaxial
    stretch, stress [MPa]
    1.12, 0.14

A column ``test`` gives each line its own test, so that one file may contain several. A line without
a value in a column has nothing or a ``-`` there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from fem_snh.arrays import Array, ArrayLike
from fem_snh.errors import (
    BadInput,
    bad_value,
    choose,
    is_number,
    nearest_file,
    shown,
    suggestion_for,
)
from fem_snh.files import read_text
from fem_snh.records.units import stress_unit
from fem_snh.studies.fit.responses import FREE, MEASURES

#: Built-in data, by name.
DATASETS = {file.stem: file for file in sorted(Path(__file__).parent.glob("tables/*.csv"))}
#: Columns that measure the deformation, the deformation in direction 2, and the stress.
_DEFORMATIONS, _SECOND = ("stretch", "strain", "shear", "volume_ratio"), ("stretch_2", "strain_2")
_STRESSES = ("stress", "pressure", "stress_2", "stress_difference")
_COLUMNS = (*_DEFORMATIONS, *_SECOND, *_STRESSES, "test", "weight")
#: The tests, and their columns of deformations and stresses.
TESTS = dict.fromkeys((*FREE, "biaxial"), "stretch strain stress") | {
    "biaxial": "stretch strain stretch_2 strain_2 stress stress_2 stress_difference",
    "simple_shear": "shear strain stress",
    "volumetric": "stretch strain volume_ratio stress pressure",
    "confined": "stretch strain stress pressure",
}
_COLUMN = re.compile(r"(?P<name>[^\[(]*)([\[(](?P<unit>[^\])]*)[\])])?")
#: Rubber and gels are stretched to 10, or not much more: larger stretches are strains in per cent.
_LARGEST_STRETCH = 12.0
#: Sums of squares of numbers from this one to its inverse, and of their products, neither overflow
#: nor underflow.
_LEAST = 1e-60
WITH_A_SQUARE = f"0, or a number whose absolute value is from {_LEAST:g} to {1 / _LEAST:g}"
#: Cells without a value.
_NO_VALUE = ("", "-")


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
        ``simple_shear``; the stress that ``measure`` names of ``biaxial``.
    weight : float or (n,)
        Weights of the residuals, proportional to the inverse of their standard deviations. Points
        of weight 0 are left out.
    stretch_2 : float or (n,), optional
        Stretch in the second direction of ``biaxial``.
    measure : str
        The stress of ``biaxial``: "stress" or "stress_2", the nominal stress of direction 1
        or 2, or "stress_difference", the true stress of direction 1 minus that of direction 2.
    unit : str
        Unit of the stresses, "" if it is not known.

    Raises
    ------
    BadInput
        For an unknown kind or measure, a missing or surplus `stretch_2`, numbers that are not one
        for each x or whose squares overflow or underflow, and weights that are all 0.
    """

    __test__ = False  # the name is not one of a test of pytest's

    name: str
    kind: str
    x: Array
    stress: Array
    weight: Array
    stretch_2: Array | None = None
    measure: str = "stress"
    unit: str = ""

    def __post_init__(self) -> None:
        biaxial = self.kind == "biaxial"
        choose(f"{self.name}: kind", self.kind, TESTS)
        choose(f"{self.name}: measure", self.measure, MEASURES if biaxial else MEASURES[:1])
        if biaxial == (self.stretch_2 is None):
            raise BadInput(
                f"{self.name}: test '{self.kind}': expected {'' if biaxial else 'no '}stretch_2"
            )
        shape = np.shape(self.x) or (1,)
        keys = ("x", "stress", "weight", *(["stretch_2"] if biaxial else []))
        for key in keys:
            value = getattr(self, key)
            try:
                array = np.broadcast_to(np.asarray(value, dtype=np.float64), shape)
            except (TypeError, ValueError):
                accepted = "one number, or one for each x"
                raise bad_value(f"{self.name}: {key}", value, accepted) from None
            if key in ("stress", "weight") and not is_safe_to_square(array).all():
                raise bad_value(f"{self.name}: {key}", value, WITH_A_SQUARE)
            object.__setattr__(self, key, array)
        counted = self.weight != 0
        if not counted.any():
            raise bad_value(f"{self.name}: weight", self.weight, "one other than 0")
        for key in keys:
            object.__setattr__(self, key, getattr(self, key)[counted])

    @property
    def rest(self) -> float:
        """Return the x of the state at rest."""
        return 0.0 if self.kind == "simple_shear" else 1.0


def is_safe_to_square(value: ArrayLike) -> Array:
    """Return a mask of the numbers that are 0 or of a size from `_LEAST` to its inverse."""
    size = np.abs(np.asarray(value, dtype=np.float64))
    return np.asarray((size == 0) | (size >= _LEAST) & (size <= 1 / _LEAST))


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
        override the file. Columns with other names are not used.
    modulus_unit : str, optional
        Unit in which the stresses are returned; default: Pa, or unchanged if the file states no
        unit.

    Raises
    ------
    BadInput
        If the file cannot be read or is not valid.
    """
    path = Path(path)
    stated, lines = read_cells(path)
    try:
        size = 1.0 if weight is None else float(weight)
        return _tests(path.stem, test or stated, lines, columns, unit, size, modulus_unit)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _tests(
    name: str,
    test: str,
    lines: list[tuple[int, list[str]]],
    columns: Sequence[str] | None,
    unit: str | None,
    weight: float,
    modulus_unit: str | None,
) -> list[TestData]:
    """Return the tests in the lines of a file."""
    header = [] if any(map(is_number, lines[0][1])) else lines[0][1]
    if not (names := columns or header):
        raise BadInput(
            "no line of column names above the numbers: expected one, e.g. 'stretch, stress "
            "[MPa]', or --columns stretch,stress"
        )
    found = _columns(names)
    measures = [column for column in _STRESSES if column in found]
    units = {c: unit or found[c][1] for c in measures}
    if "" in units.values() and (any(units.values()) or modulus_unit is not None):
        raise BadInput(
            f"columns {', '.join(measures)}: expected units of all, or of none and no modulus_unit"
        )
    table = _table(found, lines[bool(header) :], max(len(names), len(header)))
    if test:
        table["test"] = test
    if "test" not in table:
        raise BadInput(f"no test: expected a line '# test = {'|'.join(TESTS)}', or --test")
    groups = [
        (choose("test", kind, TESTS), measure, rows.dropna(subset=measure))
        for kind, rows in table.groupby("test", sort=False)
        for measure in measures
        if rows[measure].notna().any()
    ]
    groups.sort(key=lambda group: group[2].index[0])
    kinds = [kind for kind, _, _ in groups]
    tests = []
    for kind, measure, points in groups:
        words = [kind] * (len(set(kinds)) > 1) + [measure] * (kinds.count(kind) > 1)
        x, y = _stretches(kind, measure, points, found)
        size = stress_unit("unit", units[measure]) if units[measure] else 1.0
        size /= stress_unit("modulus_unit", modulus_unit) if modulus_unit else 1.0
        stress = size * points[measure].to_numpy()
        if measure == "pressure":  # positive in compression, and per deformed area
            stress = -stress * (x**2 if kind == "volumetric" else 1.0)
        data = TestData(
            " ".join([name, *words]), kind, x, stress,
            weight * np.asarray(points.get("weight", 1.0)), y,
            measure if kind == "biaxial" else "stress",
            (modulus_unit or "Pa") if units[measure] else "",
        )  # fmt: skip
        _check_signs(data)
        tests.append(data)
    return tests


def read_cells(path: Path) -> tuple[str, list[tuple[int, list[str]]]]:
    """Return the test that a comment states, or "", and (number, cells) of each other line.

    Raises BadInput for a file that cannot be read, and for one without such lines.
    """
    built_in = DATASETS.get(str(path)) if not path.exists() else None
    try:
        text = read_text(built_in or path, encoding="utf-8-sig")
    except FileNotFoundError:
        suggestion = nearest_file(path) or suggestion_for(path.stem, DATASETS)
        raise BadInput(f"data = '{path}': no such file{suggestion}") from None
    except UnicodeDecodeError:
        raise BadInput(f"data = '{path}': expected a text file with columns of numbers") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"data = '{path}': {reason}") from None
    test = re.search(r"^\s*#+\s*test\s*=\s*(.+?)\s*$", text, re.M | re.I)
    rows = [
        (number, _cells(line))
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows:
        raise BadInput(f"{path}: no line of numbers: expected columns of numbers")
    return test[1] if test else "", rows


def _cells(line: str) -> list[str]:
    """Return the cells of a line; blanks separate them if no comma, semicolon or tab does."""
    for separator in (";", "\t", ","):
        if separator in line:
            return [cell.strip(' "') for cell in line.split(separator)]
    return line.split()


def _columns(cells: Sequence[str]) -> dict[str, tuple[int, str]]:
    """Return {name: (position, unit)} of the known columns; BadInput for a wrong choice."""
    found: dict[str, tuple[int, str]] = {}
    for position, cell in enumerate(cells):
        split = _COLUMN.match(cell)
        assert split is not None
        name, unit = split["name"].strip().lower(), (split["unit"] or "").strip()
        if name in found:
            raise BadInput(f"column '{cell}': expected one column {name}")
        if name in _COLUMNS:
            found[name] = (position, "" if unit == "-" else unit)
    stresses = 1 if "pressure" in found else len(_STRESSES)  # a pressure is the only one
    for group, least, most in ((_DEFORMATIONS, 1, 1), (_SECOND, 0, 1), (_STRESSES, 1, stresses)):
        if not least <= sum(column in found for column in group) <= most:
            given = shown(", ".join(cells))
            raise BadInput(f"columns = {given}: expected one column {' or '.join(group)}")
    return found


def _table(
    columns: Mapping[str, tuple[int, str]], lines: list[tuple[int, list[str]]], count: int
) -> pd.DataFrame:
    """Return the numbers in the known columns by line number, NaN for no value; tests are text."""
    if not lines:
        raise BadInput("no line of numbers below the column names")
    for line, cells in lines:
        if len(cells) > count:
            raise BadInput(
                f"line {line}: {len(cells)} values for {count} columns: expected one for each, "
                "with decimal points"
            )
    positions = [position for position, _ in columns.values()]
    text = pd.DataFrame([cells for _, cells in lines], [line for line, _ in lines])
    text = text.reindex(columns=positions).set_axis(list(columns), axis=1)
    text = text.where(~text.isin(_NO_VALUE))
    table = text.copy()
    for column in text.columns.drop("test", errors="ignore"):
        table[column] = pd.to_numeric(text[column], errors="coerce").astype(float)
        bad = text[column].notna() & ~(table[column].notna() & is_safe_to_square(table[column]))
        for line in text.index[bad]:
            raise bad_value(f"line {line}: {column}", text[column][line], WITH_A_SQUARE)
    measures = [column for column in _STRESSES if column in columns]
    needed = table.drop(columns=[*measures, *_SECOND], errors="ignore")
    for line in table.index[needed.isna().any(axis=1) | table[measures].isna().all(axis=1)]:
        missing = needed.columns[needed.loc[line].isna()]
        raise BadInput(f"line {line}: no value of {', '.join(missing) or ' or '.join(measures)}")
    for line in table.index[table["weight"] < 0] if "weight" in table else ():
        raise bad_value(f"line {line}: weight", text["weight"][line], "a number >= 0")
    return table


def _stretches(
    kind: str, measure: str, points: pd.DataFrame, columns: Mapping[str, tuple[int, str]]
) -> tuple[Array, Array | None]:
    """Return the stretches (or amounts of shear), and the stretches in direction 2 or None."""
    accepted = TESTS[kind].split()
    given = [c for c in (*_DEFORMATIONS, *_SECOND) if c in columns and points[c].notna().any()]
    for column in (*given, measure):
        if column not in accepted:
            raise BadInput(
                f"line {points.index[0]}: {column} in a test '{kind}': expected "
                f"{' or '.join(accepted)}, or --columns without it"
            )
    found = []
    for column in given:
        unit = columns[column][1]
        if unit not in ("", "%"):
            raise bad_value(f"unit of {column}", unit, "none or %")
        size = 0.01 if unit == "%" else 1.0
        rest = 1.0 if column.startswith("strain") and kind != "simple_shear" else 0.0
        stretches = rest + size * points[column].to_numpy()
        if kind != "simple_shear":
            most = np.inf if unit == "%" else _LARGEST_STRETCH
            for at in np.flatnonzero(~((stretches > 0) & (stretches <= most))):
                where = f"line {points.index[at]}: {column}"
                limits = f"a number > {0 - rest / size:g}, or a column 'strain [%]'"
                raise bad_value(where, points[column].iloc[at], limits)
        found.append(stretches ** (1 / 3) if column == "volume_ratio" else stretches)
    return found[0], found[1] if len(found) > 1 else None


def _check_signs(test: TestData) -> None:
    """Raise BadInput without a deformation or a stress, or if every stress has the wrong sign."""
    kind, x, y, stress = test.kind, test.x, test.stretch_2, test.stress
    moved = x != test.rest if y is None else (x != 1) | (y != 1)
    if not moved.any() or not stress.any():
        raise BadInput(f"test '{kind}': expected a deformation and a stress other than 0")
    if y is None:
        signs, accepted = x - test.rest, "stresses above 0 in tension, below 0 in compression"
    elif test.measure == "stress_difference":
        # The larger stretch has the larger true stress (Baker & Ericksen 1954).
        signs = x - y
        accepted = "different stretches, and the true stress of direction 1 minus that of 2"
    else:
        return
    if (stress * signs <= 0).all():
        raise BadInput(f"test '{kind}': every stress has the wrong sign: expected {accepted}")
