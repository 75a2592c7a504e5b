"""Read test data: stretches and stresses of homogeneous deformations.

A file has lines of numbers with commas, semicolons, tabs or blanks between. A line of column names
may stand above them, with units in brackets, and comment lines ``# key = value``::

    # test = uniaxial
    stretch, stress [MPa]
    1.12, 0.14

A column ``test`` gives each line its own test, so that one file may contain several. A line without
a value in a column has nothing or a ``-`` there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from fem_snh.errors import BadInput, bad_value, choose, is_number, nearest, nearest_file, shown
from fem_snh.files import read_text
from fem_snh.records.units import stress_unit
from fem_snh.studies.fit.responses import FREE, MEASURES

Array = npt.NDArray[np.float64]

#: Names of the tests, and other names that files may use for them.
TESTS = {
    "uniaxial": "tension compression ut simple_tension",
    "equibiaxial": "et eb",
    "planar": "pure_shear ps planar_tension",
    "biaxial": "general_biaxial bt",
    "simple_shear": "shear ss",
    "volumetric": "hydrostatic bulk",
    "confined": "oedometric uniaxial_strain",
}
#: Names of the columns, and other names that files may use for them; _11 counts as _1, _22 as _2.
COLUMNS = {
    "stretch": "lambda λ stretch_ratio s stretch_1 lambda_1",
    "strain": "engineering_strain nominal_strain eps epsilon ε",
    "shear": "gamma γ amount_of_shear shear_strain",
    "volume_ratio": "j v/v0",
    "stretch_2": "lambda_2 stretch_ratio_2",
    "strain_2": "engineering_strain_2 nominal_strain_2",
    "stress": "nominal_stress engineering_stress pk1 p shear_stress force/area stress_1 p_1 pk1_1",
    "pressure": "hydrostatic_pressure",
    "stress_2": "nominal_stress_2 engineering_stress_2 p_2 pk1_2",
    "stress_difference": "true_stress_difference cauchy_stress_difference",
    "test": "kind mode",
    "weight": "",
}
#: Built-in data, by name.
DATASETS = {file.stem: file for file in sorted(Path(__file__).parent.glob("tables/*.csv"))}
#: Columns that measure the deformation, that of the second direction, and the stress.
_DEFORMATIONS, _SECOND = ("stretch", "strain", "shear", "volume_ratio"), ("stretch_2", "strain_2")
_STRESSES = ("stress", "pressure", "stress_2", "stress_difference")
#: Deformations and stresses of some tests, and of the others.
_MEASURED_IN = {
    "biaxial": "stretch strain stretch_2 strain_2 stress stress_2 stress_difference",
    "simple_shear": "shear strain stress",
    "volumetric": "stretch strain volume_ratio stress pressure",
    "confined": "stretch strain stress pressure",
}
_MEASURED = "stretch strain stress"
#: The test of a file with a column that belongs to one test.
_TEST_OF = {
    "shear": "simple_shear",
    "volume_ratio": "volumetric",
    "stretch_2": "biaxial",
    "strain_2": "biaxial",
}
_STATED = ("test", "unit", "weight", "columns")
_COMMENT = re.compile(r"#+\s*(\w+)\s*[=:]\s*(.+?)\s*$")
#: Similarity (difflib) from which an unknown name is a misspelling: 'units' of 'unit' has 0.89,
#: 'wieght' of 'weight' 0.83, but 'stress_sd' of 'stress' 0.8.
_MISSPELT = 0.82
_COLUMN = re.compile(r"^(?P<name>[^\[\(]*?)\s*[\[\(]\s*(?P<unit>[^\]\)]*)[\]\)]\s*$")
#: Units of a column that has none.
_NO_UNIT = ("", "-", "1", "mm/mm", "m/m")
#: Rubber and gels are stretched to 10 at most, or not much more.
_LARGEST_STRETCH = 12.0
#: Sums of squares of numbers from this one to its inverse, and of their products, are numbers.
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
        ``simple_shear``. Of ``biaxial`` it is that of `measure`.
    weight : float or (n,)
        Weights of the residuals, proportional to the inverse of their standard deviations. Points
        of weight 0 are left out.
    stretch_2 : float or (n,), optional
        Stretch in the second direction of ``biaxial``.
    measure : str
        What is measured in ``biaxial``: "stress" or "stress_2", the nominal stress of direction 1
        or 2, or "stress_difference", the true stress of direction 1 minus that of direction 2.
    in_per_cent : bool
        Whether the deformation is stated in per cent.
    unit : str
        Unit of the stresses, "" if it is not known.

    Raises
    ------
    BadInput
        For an unknown kind or measure, a missing or surplus `stretch_2`, numbers that are not one
        for each x, numbers whose squares are no numbers, and weights that are all 0.
    """

    __test__ = False  # the name is not one of a test of pytest's

    name: str
    kind: str
    x: Array
    stress: Array
    weight: Array
    stretch_2: Array | None = None
    measure: str = "stress"
    in_per_cent: bool = False
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
            if key in ("stress", "weight") and not has_a_square(array).all():
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

    @property
    def note(self) -> str:
        """The line that says that stretches are probably strains in per cent; "" if not."""
        largest = float(max(self.x.max(), 1.0 if self.stretch_2 is None else self.stretch_2.max()))
        if self.in_per_cent or self.kind not in (*FREE, "biaxial") or largest <= _LARGEST_STRETCH:
            return ""
        return (
            f"{self.name}: stretches up to {largest:.4g}: if these are strains in per cent, name "
            "the column 'strain [%]'"
        )


def has_a_square(value: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return which numbers are 0 or of a size from `_LEAST` to its inverse."""
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
        replace those that the file states. Columns with other names are not used.
    modulus_unit : str, optional
        Unit in which the stresses are returned; default: Pa, or that of the file if none is stated.

    Raises
    ------
    BadInput
        For everything that is wrong in the file.
    """
    path = Path(path)
    stated, lines = read_cells(path)
    given = {"test": test, "weight": weight}
    stated |= {key: str(value) for key, value in given.items() if value is not None}
    try:
        return _tests(path.stem, stated, lines, columns, unit, modulus_unit)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _tests(
    name: str,
    stated: dict[str, str],
    lines: list[tuple[int, list[str]]],
    columns: Sequence[str] | None,
    unit: str | None,
    modulus_unit: str | None,
) -> list[TestData]:
    """Return the tests in the lines of a file."""
    header = [] if any(map(is_number, lines[0][1])) else lines[0][1]
    names = columns or (_cells(stated["columns"]) if "columns" in stated else header)
    if not names:
        raise BadInput(
            "no line of column names above the numbers: expected one, e.g. 'stretch, stress "
            "[MPa]', or --columns stretch,stress"
        )
    found = _columns(names)
    measures = [column for column in _STRESSES if column in found]
    units = {c: _unit(c, found[c][1], stated.get("unit", ""), unit) for c in measures}
    if "" in units.values() and any(units.values()):
        raise BadInput(f"columns {', '.join(measures)}: expected units of all, or of none")
    if modulus_unit is not None and "" in units.values():
        accepted = "data whose stresses have a unit: stress [MPa], or --unit"
        raise bad_value("modulus_unit", modulus_unit, accepted)
    table = _table(found, lines[bool(header) :], max(len(names), len(header)))
    weight = _number("weight", stated.get("weight", "1"))
    if not weight > 0:
        raise bad_value("weight", stated["weight"], "a number > 0")
    by_kind = table.groupby(pd.Series(_kinds(stated, table), table.index), sort=False)
    groups = [
        (str(kind), measure, rows.dropna(subset=measure))
        for kind, rows in by_kind
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
        test = TestData(
            " ".join([name, *words]), kind, x, stress,
            weight * np.asarray(points.get("weight", 1.0)), y,
            measure if kind == "biaxial" else "stress",
            any(found[c][1] == "%" for c in _DEFORMATIONS if c in found),
            (modulus_unit or "Pa") if units[measure] else "",
        )  # fmt: skip
        _check_signs(test)
        tests.append(test)
    return tests


def read_cells(path: Path) -> tuple[dict[str, str], list[tuple[int, list[str]]]]:
    """Return what the comments of a file state, and the number and the cells of each other line.

    Raises BadInput for a file that cannot be read, and for one without such lines.
    """
    built_in = DATASETS.get(str(path)) if not path.exists() else None
    try:
        text = read_text(built_in or path, encoding="utf-8-sig")
    except FileNotFoundError:
        suggestion = nearest_file(path) or nearest(path.stem, DATASETS)
        raise BadInput(f"data = '{path}': no such file{suggestion}") from None
    except UnicodeDecodeError:
        raise BadInput(f"data = '{path}': expected a text file with columns of numbers") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"data = '{path}': {reason}") from None
    stated, rows = _lines(path, text)
    if not rows:
        raise BadInput(f"{path}: no line of numbers: expected columns of numbers")
    return stated, rows


def _lines(path: Path, text: str) -> tuple[dict[str, str], list[tuple[int, list[str]]]]:
    """Return what the comments state, and the number and the cells of the other lines."""
    stated: dict[str, str] = {}
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip().startswith("#"):
            if found := _COMMENT.match(line.strip()):
                key = found[1].lower()
                if key in _STATED:
                    stated[key] = found[2]
                else:
                    _check_spelling(f"{path}: line {number}: '{line.strip()}'", key, _STATED)
        elif line.strip():
            rows.append((number, _cells(line)))
    return stated, rows


def _check_spelling(what: str, word: str, known: Iterable[str]) -> None:
    """Raise BadInput if an unknown word is nearly a known one.

    A name that differs in its number alone is another one: stress_3 is no misspelt stress_2.
    """
    close = get_close_matches(word, known, 1, _MISSPELT)
    if close and re.sub(r"_?\d+$", "", word) != re.sub(r"_?\d+$", "", close[0]):
        raise BadInput(
            f"{what}: unknown name (did you mean '{close[0]}'?): expected another if it is no data"
        )


def _cells(line: str) -> list[str]:
    """Return the cells of a line; blanks separate them if no comma, semicolon or tab does."""
    for separator in (";", "\t", ","):
        if separator in line:
            return [cell.strip() for cell in line.rstrip(f" {separator}").split(separator)]
    return line.split()


def _by_name(names: Mapping[str, str]) -> dict[str, str]:
    """Return the name here of each accepted name."""
    return {name: known for known, others in names.items() for name in (known, *others.split())}


def _columns(cells: Sequence[str]) -> dict[str, tuple[int, str]]:
    """Return the position and the unit of each known column."""
    known = _by_name(COLUMNS)
    found: dict[str, tuple[int, str]] = {}
    for position, cell in enumerate(cells):
        split = _COLUMN.match(cell.strip().strip('"'))
        name, unit = (split["name"], split["unit"]) if split else (cell.strip().strip('"'), "")
        word = re.sub(r"_([12])\1$", r"_\1", re.sub(r"[\s_]+", "_", name.strip().lower()))
        if re.fullmatch("(true_stress|cauchy_stress|cauchy)(_[12])?", word):
            raise BadInput(f"column '{cell}': expected the nominal stress, force per area at rest")
        if word not in known:
            _check_spelling(f"column '{cell}'", word, COLUMNS)
            continue
        if known[word] in found:
            raise BadInput(f"column '{cell}': expected one column {known[word]}")
        found[known[word]] = (position, "" if unit.strip() in _NO_UNIT else unit.strip())
    stresses = 1 if "pressure" in found else len(_STRESSES)  # a pressure is the only one
    for group, least, most in ((_DEFORMATIONS, 1, 1), (_SECOND, 0, 1), (_STRESSES, 1, stresses)):
        if not least <= sum(column in found for column in group) <= most:
            given = shown(", ".join(cells))
            raise BadInput(f"columns = {given}: expected one column {' or '.join(group)}")
    return found


def _table(
    columns: Mapping[str, tuple[int, str]], lines: list[tuple[int, list[str]]], count: int
) -> pd.DataFrame:
    """Return the numbers in the known columns, by lines; NaN is no value. Tests remain text."""
    if not lines:
        raise BadInput("no line of numbers below the column names")
    measures = [c for c in _STRESSES if c in columns]
    rows = {}
    for number, cells in lines:
        where = f"line {number}"
        if len(cells) > count:
            raise BadInput(
                f"{where}: {len(cells)} values for {count} columns: expected one for each, with "
                "decimal points"
            )
        cells = [*cells, *[""] * count]
        given = {c: cells[at] for c, (at, _) in columns.items() if cells[at] not in _NO_VALUE}
        missing = [c for c in columns if c not in (*given, *_SECOND, *measures)]
        missing += [] if given.keys() & measures else [" or ".join(measures)]
        if missing:
            raise BadInput(f"{where}: no value of {', '.join(missing)}")
        rows[number] = {
            column: text if column == "test" else _number(f"{where}: {column}", text)
            for column, text in given.items()
        }
        if float(given.get("weight", 0)) < 0:
            raise bad_value(f"{where}: weight", given["weight"], "a number >= 0")
    return pd.DataFrame.from_dict(rows, orient="index", columns=list(columns))


def _kinds(stated: Mapping[str, str], table: pd.DataFrame) -> list[str]:
    """Return the kind of test of each line."""
    if "test" not in stated and "test" in table:
        return [_kind(f"line {line}: test", text) for line, text in table["test"].items()]
    kinds = [kind for column, kind in _TEST_OF.items() if column in table]
    if "test" not in stated and not kinds:
        names = "|".join(TESTS)
        raise BadInput(f"no test: expected a line '# test = {names}', a column test, or --test")
    return [_kind("test", stated.get("test") or kinds[-1])] * len(table)


def _kind(key: str, text: str) -> str:
    """Return the kind of test that a file names."""
    word = re.sub(r"[\s_-]+", "_", text.strip().strip('"').lower())
    return choose(key, _by_name(TESTS).get(word, word), list(TESTS))


def _unit(column: str, named: str, comment: str, option: str | None) -> str:
    """Return the unit of a column of stresses, "" if it has none, from its name or a comment."""
    if option is None and named and comment:
        if stress_unit("unit", named) != stress_unit("unit", comment):
            accepted = f"that of the column {column}, '{named}', or --unit"
            raise bad_value("# unit", comment, accepted)
    unit = option or comment or named
    return "" if unit in _NO_UNIT else unit


def _stretches(
    kind: str, measure: str, points: pd.DataFrame, columns: Mapping[str, tuple[int, str]]
) -> tuple[Array, Array | None]:
    """Return the stretches, or the amounts of shear, and those of the second direction."""
    accepted = _MEASURED_IN.get(kind, _MEASURED).split()
    given = [c for c in (*_DEFORMATIONS, *_SECOND) if c in columns and points[c].notna().any()]
    for column in (*given, measure):
        if column not in accepted:
            alternative = ", or test = biaxial" if column in _MEASURED_IN["biaxial"] else ""
            raise BadInput(
                f"line {points.index[0]}: {column} in a test '{kind}': expected "
                f"{' or '.join(accepted)}{alternative}, or --columns without it"
            )
    if kind == "biaxial":
        second = next((c for c in _SECOND if c in columns), None)
        for line in points.index if second is None else points.index[points[second].isna()]:
            where = f"line {line}: test 'biaxial': expected"
            missing = f"a value of {second}" if second else "a column stretch_2"
            raise BadInput(f"{where} {missing}, or test = equibiaxial")
    found = []
    for column in given:
        unit = columns[column][1]
        if unit not in ("", "%"):
            raise bad_value(f"unit of {column}", unit, "none or %")
        size = 0.01 if unit == "%" else 1.0
        rest = 1.0 if column.startswith("strain") and kind != "simple_shear" else 0.0
        stretches = rest + size * points[column].to_numpy()
        for at in np.flatnonzero(stretches <= 0) if kind != "simple_shear" else ():
            where = f"line {points.index[at]}: {column}"
            raise bad_value(where, points[column].iloc[at], f"a number > {0 - rest / size:g}")
        found.append(stretches ** (1 / 3) if column == "volume_ratio" else stretches)
    return found[0], found[1] if len(found) > 1 else None


def _check_signs(test: TestData) -> None:
    """Raise BadInput where the points of a test cannot be a measurement."""
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


def _number(where: str, text: str | float) -> float:
    """Return a finite number of a file."""
    try:
        number = float(text)
    except ValueError:
        raise bad_value(where, text, "a number, with a decimal point") from None
    if not np.isfinite(number):
        raise bad_value(where, number, "a finite number")
    if not has_a_square(number):
        raise bad_value(where, number, WITH_A_SQUARE)
    return number
