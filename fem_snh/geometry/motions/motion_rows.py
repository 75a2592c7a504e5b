"""Rows of a CSV file that describe motions: 3x4 matrices, or rigid poses, at loads or times."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput, nearest_file, shown, unknown_name
from fem_snh.files import read_text
from fem_snh.geometry.shapes.shape import Array

TRANSLATION = ("x", "y", "z")
ROTATION = ("rx", "ry", "rz")
AFFINE = tuple(f"a{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3, 4))
#: The column with the name of the bone that a row moves.
BONE = "bone"
_COLUMNS = (
    f"a first column 'load' or 'time', then {', '.join(TRANSLATION)} and, if it turns, "
    f"{', '.join(ROTATION)}; or a11, a12, ..., a34"
)
#: How far a table may miss the end of the motion, in parts of its length: rounded decimals.
_ROUNDED = 1e-9


@dataclass(frozen=True)
class MotionRows:
    """The rows of a CSV file.

    Attributes
    ----------
    path : Path
        The file.
    names : list of str
        Names of the columns with numbers; the first is "load" or "time".
    lines : list of int
        The line of each row in the file.
    numbers : (rows, columns) array
        The numbers.
    bones : list of str
        The bone that each row moves; empty without that column.
    """

    path: Path
    names: list[str]
    lines: list[int]
    numbers: Array
    bones: list[str]

    def of_bone(self, name: str) -> MotionRows:
        """Return the rows of a bone, or all rows of a file without a column of bones.

        Raises
        ------
        BadInput
            If the file has fewer than two rows of the bone.
        """
        if not self.bones:
            return self
        found = [i for i, bone in enumerate(self.bones) if bone == name]
        if not found:
            raise BadInput(
                f"motion = '{self.path}': {unknown_name('bone', name, dict.fromkeys(self.bones))}"
            )
        if len(found) < 2:
            raise BadInput(f"motion = '{self.path}': expected two rows or more of bone '{name}'")
        lines = [self.lines[i] for i in found]
        return MotionRows(self.path, self.names, lines, self.numbers[found], [])

    def loads(self, duration: float | None) -> Array:
        """Return the load of each row; times are divided by the duration [s].

        Raises
        ------
        BadInput
            Unless loads ascend from 0 or less to 1 or more.
        """
        name, given, lines = self.names[0], self.numbers[:, 0], self.lines
        if name == "time" and duration is None:
            raise BadInput(
                f"motion = '{self.path}': expected a column 'load' instead of 'time', as the scene "
                "has no [time]"
            )
        loads: Array = given / (duration if name == "time" and duration else 1.0)
        for i in np.flatnonzero(np.diff(given) <= 0)[:1]:
            raise BadInput(
                f"{self.path}, line {lines[i + 1]}: {name} = {given[i + 1]:g}: expected more than "
                f"{given[i]:g}, that of the row before"
            )
        if loads[0] > _ROUNDED:
            raise BadInput(f"{self.path}, line {lines[0]}: {name} = {given[0]:g}: expected 0")
        if loads[-1] < 1 - _ROUNDED:
            end = f"the end of the run, {duration:g} s" if name == "time" else "the load 1"
            raise BadInput(
                f"{self.path}, line {lines[-1]}: {name} = {given[-1]:g}: expected rows up to {end}"
            )
        return loads

    @property
    def has_matrices(self) -> bool:
        """Whether the columns are those of 3x4 matrices."""
        return AFFINE[0] in self.names

    def columns(self, names: tuple[str, ...]) -> Array:
        """Return the numbers (rows, k) of some columns."""
        return self.numbers[:, [self.names.index(name) for name in names]]

    def matrices(self) -> Array:
        """Return the 3x4 matrices (rows, 3, 4)."""
        return self.columns(AFFINE).reshape(-1, 3, 4)


def read_rows(path: str | Path, with_bones: bool = False) -> MotionRows:
    """Read a CSV file with a line of column names; lines that begin with # are comments.

    Parameters
    ----------
    path : str or Path
        The file.
    with_bones : bool
        Accept a column of the bones' names.

    Raises
    ------
    BadInput
        One line, for a file that cannot be read or with other columns.
    """
    path = Path(path)
    found = _read_cells(path)
    names = found[0][1]
    _check_columns(path, names, with_bones)
    for line, row in found[1:]:
        if len(row) != len(names):
            expected = f"{len(names)} {'columns' if BONE in names else 'numbers'}"
            raise BadInput(f"{path}, line {line}: expected {expected}, found {len(row)}")
    columns = [i for i, name in enumerate(names) if name != BONE]
    numbers = [[_number(path, line, names[i], row[i]) for i in columns] for line, row in found[1:]]
    bones = [row[names.index(BONE)] for _, row in found[1:]] if BONE in names else []
    lines = [line for line, _ in found[1:]]
    return MotionRows(path, [names[i] for i in columns], lines, np.array(numbers), bones)


def _read_cells(path: Path) -> list[tuple[int, list[str]]]:
    """Return the cells of each row with the number of its line."""
    try:
        text = read_text(path, encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(f"motion = '{path}': expected a CSV file of UTF-8 text") from None
    except OSError as error:
        near = nearest_file(path)
        raise BadInput(f"cannot read the motion {path}: {error.strerror}{near}") from None
    rows = csv.reader(text.splitlines(), skipinitialspace=True)
    try:
        found = [(rows.line_num, [cell.strip() for cell in row]) for row in rows if any(row)]
    except csv.Error as error:  # a cell of more than 131,072 characters
        raise BadInput(f"{path}, line {rows.line_num}: {error}: expected a number") from None
    found = [(line, row) for line, row in found if not row[0].startswith("#")]
    if len(found) < 3:
        raise BadInput(f"motion = '{path}': expected a line of column names and two rows or more")
    return found


def _number(path: Path, line: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise BadInput(f"{path}, line {line}: {name} = {shown(cell)}: expected a finite number")
    if abs(value) > LARGEST_NUMBER:
        accepted = f"a number of a size up to {LARGEST_NUMBER:g}"
        raise BadInput(f"{path}, line {line}: {name} = {shown(cell)}: expected {accepted}")
    return value


def _check_columns(path: Path, names: list[str], with_bones: bool) -> None:
    """Raise BadInput for columns that are unknown, missing, or there twice."""
    more = (BONE,) if with_bones else ()
    known = ("load", "time", *more, *TRANSLATION, *ROTATION, *AFFINE)
    for name in names:
        if name not in known:
            raise BadInput(f"motion = '{path}': {unknown_name('column', name, known)}")
    accepted = (TRANSLATION, (*TRANSLATION, *ROTATION), AFFINE)
    rest = sorted(names[1:])
    if BONE in rest:
        rest.remove(BONE)
    if names[0] not in ("load", "time") or rest not in [sorted(group) for group in accepted]:
        bone = ", and 'bone' if the file moves several bones" if with_bones else ""
        raise BadInput(f"motion = '{path}': expected the columns: {_COLUMNS}{bone}")
