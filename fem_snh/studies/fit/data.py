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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput, bad_value, choose, nearest, nearest_file, shown
from fem_snh.files import read_text
from fem_snh.records.units import stress_unit
from fem_snh.studies.fit.responses import MEASURES

Array = npt.NDArray[np.float64]

#: Names of the tests, and other names that files may use for them.
TESTS = {
    "uniaxial": ("tension", "compression", "ut", "simple_tension"),
    "equibiaxial": ("et", "eb"),
    "planar": ("pure_shear", "ps", "planar_tension"),
    "biaxial": ("general_biaxial", "bt"),
    "simple_shear": ("shear", "ss"),
    "volumetric": ("hydrostatic", "bulk"),
    "confined": ("oedometric", "uniaxial_strain"),
}
#: Names of the columns, and other names that files may use for them; _11 counts as _1, _22 as _2.
COLUMNS = {
    "stretch": ("lambda", "λ", "stretch_ratio", "s", "stretch_1", "lambda_1"),
    "strain": ("engineering_strain", "nominal_strain", "eps", "epsilon", "ε"),
    "shear": ("gamma", "γ", "amount_of_shear", "shear_strain"),
    "volume_ratio": ("j", "v/v0"),
    "stretch_2": ("lambda_2", "stretch_ratio_2"),
    "strain_2": ("engineering_strain_2", "nominal_strain_2"),
    "stress": (
        "nominal_stress",
        "engineering_stress",
        "pk1",
        "p",
        "shear_stress",
        "force/area",
        "stress_1",
        "p_1",
        "pk1_1",
    ),
    "pressure": ("hydrostatic_pressure",),
    "stress_2": ("nominal_stress_2", "engineering_stress_2", "p_2", "pk1_2"),
    "stress_difference": ("true_stress_difference", "cauchy_stress_difference"),
    "test": ("kind", "mode"),
    "weight": (),
}
#: Built-in data, by name.
DATASETS = {file.stem: file for file in sorted(Path(__file__).parent.glob("tables/*.csv"))}
#: Columns that measure the deformation, that of the second direction, and the stress.
_DEFORMATIONS, _SECOND = ("stretch", "strain", "shear", "volume_ratio"), ("stretch_2", "strain_2")
_STRESSES = ("stress", "pressure", "stress_2", "stress_difference")
#: The test of deformations that belong to one.
_OF_DEFORMATION = {"shear": "simple_shear", "volume_ratio": "volumetric"}
#: What a column is in the messages of a file without it.
_DEFORMATION_WORDS = "stretch or strain (shear of simple_shear, volume_ratio of volumetric)"
_STRESS_WORDS = "stress or pressure (of biaxial also stress_2, stress_difference)"
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
#: Stretches are probably strains in per cent if a Neo-Hookean material fitted to them misses
#: more than this part of the stresses, and more than so many times what it misses of such strains.
#: Of Treloar's data and of five materials at stretches from 1.2 to 10 it misses less than that.
_MISFIT, _LESS_OF_STRAINS = 0.05, 5.0
#: Stretches below this one are clearly compression.
_COMPRESSED = 0.9
#: The exponents n of the stress, x - x^-n, of an incompressible Neo-Hookean material.
_NEO_HOOKEAN = {"uniaxial": 2, "equibiaxial": 5, "planar": 3}
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
        shape: tuple[int, ...] | None = None
        keys = ("x", "stress", "weight", *(["stretch_2"] if biaxial else []))
        for key in keys:
            value = getattr(self, key)
            try:
                array = np.asarray(value, dtype=np.float64)
                shape = shape or array.shape or (1,)
                object.__setattr__(self, key, np.broadcast_to(array, shape))
            except (TypeError, ValueError):
                accepted = "one number, or one for each x"
                raise bad_value(f"{self.name}: {key}", value, accepted) from None
            if key in ("stress", "weight") and not has_a_square(array).all():
                raise bad_value(f"{self.name}: {key}", value, WITH_A_SQUARE)
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
        if self.in_per_cent or self.kind not in (*_NEO_HOOKEAN, "biaxial"):
            return ""
        largest = float(max(self.x.max(), 1.0 if self.stretch_2 is None else self.stretch_2.max()))
        if largest <= _LARGEST_STRETCH and not self._fits_strains_in_per_cent():
            return ""
        return (
            f"{self.name}: stretches up to {largest:.4g}: if these are strains in per cent, name "
            "the column 'strain [%]'"
        )

    def _fits_strains_in_per_cent(self) -> bool:
        """Return whether stresses belong to strains x or x - 1 in per cent, not to stretches x."""
        if self.kind not in _NEO_HOOKEAN or (self.x <= 0).any():
            return False
        power = -float(_NEO_HOOKEAN[self.kind])
        as_stretches, *as_strains = (
            _misfit(x - x**power, self.stress)
            for x in (self.x, 1 + self.x / 100, 1 + (self.x - 1) / 100)
        )
        return as_stretches > max(_MISFIT, _LESS_OF_STRAINS * min(as_strains))


def has_a_square(value: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return which numbers are 0 or of a size from `_LEAST` to its inverse."""
    size = np.abs(np.asarray(value, dtype=np.float64))
    return np.asarray((size == 0) | (size >= _LEAST) & (size <= 1 / _LEAST))


def _misfit(shape: Array, stress: Array) -> float:
    """Return the part of a stress that the best multiple of a shape misses."""
    square = float(shape @ shape)
    rest = stress - (shape @ stress / square if square else 0.0) * shape
    return float(np.linalg.norm(rest) / (np.linalg.norm(stress) or 1.0))


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
    header = [] if any(map(is_number, rows[0][1])) else rows[0][1]
    names, rows = names or header, rows[bool(header) :]
    if not names:
        raise BadInput(
            f"{path}: no line of column names above the numbers: expected one, e.g. "
            "'stretch, stress [MPa]', or --columns stretch,stress"
        )
    found = _columns(path, names)
    if unit is None and "unit" in stated:
        _check_units(path, stated["unit"], found)
    if not rows:
        raise BadInput(f"{path}: no line of numbers below the column names")
    count = max(len(names), len(header))
    for number, cells in rows:
        if len(cells) > count:
            raise BadInput(
                f"{path}: line {number}: {len(cells)} values for {count} columns: expected one for "
                "each, with decimal points"
            )
    return _tests(path, stated, found, rows, modulus_unit)


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
        word = re.sub(r"_([12])\1$", r"_\1", re.sub(r"[\s_]+", "_", name.strip().lower()))
        if re.fullmatch("(true_stress|cauchy_stress|cauchy)(_[12])?", word):
            raise BadInput(
                f"{path}: column '{cell}': expected the nominal stress, force per area at rest"
            )
        if word not in known:
            _check_spelling(f"{path}: column '{cell}'", word, COLUMNS)
            continue
        if known[word] in found:
            raise BadInput(f"{path}: column '{cell}': expected one column {known[word]}")
        found[known[word]] = (position, unit.strip())
    stresses = 1 if "pressure" in found else len(_STRESSES)  # a pressure is the only one
    for group, words, least, most in (
        (_DEFORMATIONS, _DEFORMATION_WORDS, 1, 1),
        (_SECOND, " or ".join(_SECOND), 0, 1),
        (_STRESSES, _STRESS_WORDS, 1, stresses),
    ):
        if not least <= sum(column in found for column in group) <= most:
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
    second = next((c for c in _SECOND if c in columns), "")
    measures = [c for c in _STRESSES if c in columns]
    if "unit" not in stated and len({columns[c][1] in _NO_UNIT for c in measures}) > 1:
        raise BadInput(f"{path}: columns {', '.join(measures)}: expected units of all, or of none")
    sizes = {
        c: _stress_size(path, stated.get("unit") or columns[c][1], modulus_unit) for c in measures
    } | {c: _deformation_size(path, c, columns[c][1]) for c in (deformation, second) if c}
    default = _kind(path, stated["test"]) if "test" in stated else None
    if default is None and "test" not in columns:
        default = "biaxial" if second else _OF_DEFORMATION.get(deformation)
    if default is None and "test" not in columns:
        raise BadInput(
            f"{path}: no test: expected a line '# test = {'|'.join(TESTS)}', a column test, or "
            "--test"
        )
    overall = _number(path, 0, stated.get("weight", "1"), "weight")
    if not overall > 0:
        raise bad_value(f"{path}: weight", stated["weight"], "a number > 0")
    needed = [c for c in columns if c not in (second, *measures)]
    points: dict[tuple[str, str], list[tuple[float, float, float, float]]] = {}
    for number, cells in rows:
        given = {
            column: cells[position]
            for column, (position, _) in columns.items()
            if position < len(cells) and cells[position] not in _NO_VALUE
        }
        measured = [c for c in measures if c in given]
        missing = [c for c in needed if c not in given]
        missing += [] if measured else [" or ".join(measures)]
        if missing:
            raise BadInput(f"{path}: line {number}: no value of {', '.join(missing)}")
        kind = default or _kind(path, given["test"], number)
        if kind == "biaxial" and second not in given:
            accepted = f"a value of {second}" if second else "a column stretch_2"
            raise BadInput(
                f"{path}: line {number}: test 'biaxial': expected {accepted}, or test = equibiaxial"
            )
        x, y = (
            _stretch(path, number, kind, c, _number(path, number, given[c], c), sizes[c])
            if c in given
            else 1.0
            for c in (deformation, second)
        )
        weight = overall
        if "weight" in columns:
            weight *= _number(path, number, given["weight"], "weight")
            if not weight >= 0:
                raise bad_value(f"{path}: line {number}: weight", given["weight"], "a number >= 0")
        for measure in measured:
            value = sizes[measure] * _number(path, number, given[measure], measure)
            if measure == "pressure":
                value = _nominal_stress(path, number, kind, x, value)
            elif measure != "stress" and kind != "biaxial":
                second_stretch = " with stretch_2 = 1" if kind == "planar" else ""
                raise BadInput(
                    f"{path}: line {number}: {measure} in a test '{kind}': expected test = biaxial"
                    f"{second_stretch}, or --columns without it"
                )
            points.setdefault((kind, measure), []).append((x, y, value, weight))
    kinds = [kind for kind, _ in points]
    found = []
    for (kind, measure), values in points.items():
        words = [kind] * (len(set(kinds)) > 1) + [measure] * (kinds.count(kind) > 1)
        test = _checked(path, " ".join([path.stem, *words]), kind, measure, np.array(values))
        unit = stated.get("unit") or columns[measure if measure in columns else "pressure"][1]
        returned = "" if unit in _NO_UNIT else modulus_unit or "Pa"
        found.append(replace(test, in_per_cent=columns[deformation][1] == "%", unit=returned))
    return found


def _check_units(path: Path, unit: str, columns: dict[str, tuple[int, str]]) -> None:
    """Raise BadInput for a column of stresses with another unit than the file's comment."""
    for column in _STRESSES:
        of_column = columns.get(column, (0, ""))[1]
        if of_column not in _NO_UNIT and _stress_size(path, of_column, None) != _stress_size(
            path, unit, None
        ):
            accepted = f"that of the column {column}, '{of_column}', or --unit"
            raise bad_value(f"{path}: # unit", unit, accepted)


def _stress_size(path: Path, unit: str, modulus_unit: str | None) -> float:
    """Return the size of a unit of stress, in Pa or in ``modulus_unit``."""
    size = stress_unit(f"{path}: unit", unit) if unit not in _NO_UNIT else 1.0
    if modulus_unit is not None:
        size /= stress_unit("modulus_unit", modulus_unit)
        if unit in _NO_UNIT:
            accepted = "data whose stresses have a unit: stress [MPa], or --unit"
            raise bad_value("modulus_unit", modulus_unit, f"{accepted}; {path} states none")
    return size


def _deformation_size(path: Path, column: str, unit: str) -> float:
    """Return the size of a unit of a deformation."""
    if unit != "%" and unit not in _NO_UNIT:
        raise bad_value(f"{path}: unit of {column}", unit, "none or %")
    return 0.01 if unit == "%" else 1.0


def _kind(path: Path, text: str, line: int = 0) -> str:
    """Return the kind of test that a file names."""
    word = re.sub(r"[\s_-]+", "_", text.strip().strip('"').lower())
    key = f"{path}: line {line}: test" if line else f"{path}: test"
    return choose(key, _kinds().get(word, word), list(TESTS))


def _stretch(path: Path, line: int, kind: str, column: str, value: float, size: float) -> float:
    """Return the stretch, or the amount of shear, of a deformation in units of ``size``."""
    where = f"{path}: line {line}: {column}"
    if _OF_DEFORMATION.get(column, kind) != kind:
        raise BadInput(f"{where} in a test '{kind}': expected stretch or strain")
    if column in _SECOND and kind != "biaxial":
        raise BadInput(
            f"{where} in a test '{kind}': expected test = biaxial, or --columns without it"
        )
    if kind == "simple_shear":
        if column == "stretch":
            raise BadInput(f"{where} in a test '{kind}': expected the amount of shear")
        return size * value
    rest = 1.0 if column.startswith("strain") else 0.0
    stretch = rest + size * value
    if not stretch > 0:
        raise bad_value(where, value, f"a number > {0 - rest / size:g}")
    return float(stretch ** (1 / 3) if column == "volume_ratio" else stretch)


def _nominal_stress(path: Path, line: int, kind: str, stretch: float, pressure: float) -> float:
    """Return the nominal stress of a pressure, which is positive in compression."""
    if kind not in ("volumetric", "confined"):
        raise BadInput(f"{path}: line {line}: pressure in a test '{kind}': expected stress")
    return -pressure * (stretch**2 if kind == "volumetric" else 1.0)  # it is per deformed area


def _checked(path: Path, name: str, kind: str, measure: str, points: Array) -> TestData:
    """Return the test of (n, 4) points; raise BadInput where they cannot be a measurement."""
    x, y, stress, weight = points.T
    if kind != "biaxial":
        found = TestData(name, kind, x, stress, weight)
        moved, direction = x != found.rest, x - found.rest
    else:
        found = TestData(name, kind, x, stress, weight, y, measure)
        moved, direction = (x != 1) | (y != 1), _sign(x, y, measure)
        if measure == "stress_difference" and (x == y).all():
            raise BadInput(
                f"{path}: test 'biaxial': stress_difference at equal stretches alone, where it is "
                "0 for every isotropic material: expected different stretches"
            )
    if not moved.any() or not stress.any():
        raise BadInput(f"{path}: test '{kind}': expected a deformation and a stress other than 0")
    clear = direction != 0
    if clear.any() and (stress[clear] * direction[clear] <= 0).all():
        raise BadInput(
            f"{path}: test '{kind}': every stress has the wrong sign: expected "
            + (
                "the true stress of direction 1 minus that of direction 2"
                if measure == "stress_difference"
                else "tension and stretches above 1 with stresses above 0, compression with "
                "stresses below 0"
            )
        )
    pressed = x < _COMPRESSED
    if kind in _NEO_HOOKEAN and pressed.any() and (stress[pressed] > 0).all():
        raise BadInput(
            f"{path}: test '{kind}': every stress at a stretch below {_COMPRESSED:g} is above 0: "
            "expected stretches, 1 at rest, or strains in a column strain"
        )
    return found


def _sign(x: Array, y: Array, measure: str) -> Array:
    """Return numbers with the sign of the stress of biaxial tests, 0 where both are possible.

    The larger stretch has the larger true stress (Baker & Ericksen 1954). The stress of direction 1
    has the sign of x - t, and t lies between that of nu = 0, 1, and that of nu = 1/2, 1/(x y).
    """
    if measure == "stress_difference":
        return x - y
    if measure == "stress_2":
        x, y = y, x
    return np.where((x - 1) * (x * x * y - 1) > 0, x - 1, 0.0)


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
    if not has_a_square(number):
        raise bad_value(where, number, WITH_A_SQUARE)
    return number
