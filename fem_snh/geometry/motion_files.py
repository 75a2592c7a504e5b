"""CSV files of motions: rows of 3x4 matrices, or of rigid poses, at loads or times."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput, nearest_file, shown, unknown_name
from fem_snh.files import read_text
from fem_snh.geometry.motions import AffineTable, Motion, PoseTable
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
#: Largest difference of R^T R from the identity: a table of 6 digits has 1e-6 in each entry.
_RIGID = 1e-5
#: Largest rotation between two rows [rad]: the shortest way is not unique at half a turn.
_HALF_TURN = np.pi * (1 - 1e-6)


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
    numbers = [
        [finite_number(f"{path}, line {line}: {names[i]} = ", row[i]) for i in columns]
        for line, row in found[1:]
    ]
    bones = [row[names.index(BONE)] for _, row in found[1:]] if BONE in names else []
    lines = [line for line, _ in found[1:]]
    return MotionRows(path, [names[i] for i in columns], lines, np.array(numbers), bones)


def _read_cells(path: Path) -> list[tuple[int, list[str]]]:
    """Return the cells of each row with the number of its line."""
    text = read_motion_text(path, "motion", "CSV")
    rows = csv.reader(text.splitlines(), skipinitialspace=True)
    try:
        found = [(rows.line_num, [cell.strip() for cell in row]) for row in rows if any(row)]
    except csv.Error as error:  # a cell of more than 131,072 characters
        raise BadInput(f"{path}, line {rows.line_num}: {error}: expected a number") from None
    found = [(line, row) for line, row in found if not row[0].startswith("#")]
    if len(found) < 3:
        raise BadInput(f"motion = '{path}': expected a line of column names and two rows or more")
    return found


def read_motion_text(path: Path, key: str, kind: str) -> str:
    """Return the text of a file of a motion. Raises BadInput."""
    try:
        return read_text(path, encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(f"{key} = '{path}': expected a {kind} file of UTF-8 text") from None
    except OSError as error:
        near = nearest_file(path)
        raise BadInput(f"cannot read the motion {path}: {error.strerror}{near}") from None


def finite_number(where: str, text: str) -> float:
    """Return the number that a text is. Raises BadInput with the place for another text."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if abs(value) <= LARGEST_NUMBER:
        return value
    size = f"number of a size up to {LARGEST_NUMBER:g}" if np.isfinite(value) else "finite number"
    raise BadInput(f"{where}{shown(text)}: expected a {size}")


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


def read_motion(path: str | Path, duration: float | None = None) -> PoseTable:
    """Read a rigid motion from a CSV file with a line of column names.

    Parameters
    ----------
    path : str or Path
        The file. Its first column is ``load`` or ``time``; then a translation ``x, y, z`` and a
        rotation vector ``rx, ry, rz`` (axis times angle [rad], about the origin, before the
        translation; may be left out), or the entries ``a11, a12, ..., a34`` of a 3x4 matrix
        [R | c], row by row. Lines that begin with # are comments.
    duration : float, optional
        The length of the run [s], at which the load is 1; without it the table has loads.

    Raises
    ------
    BadInput
        One line, for a file that cannot be read, with other columns, with times or loads that do
        not ascend or do not reach from the start to the end, with a matrix that is not a rotation
        and a translation, or with half a turn or more between two rows.
    """
    return pose_table(read_rows(path), duration)


def pose_table(rows: MotionRows, duration: float | None) -> PoseTable:
    """Return the rigid motion of the rows of a file. Raises BadInput as `read_motion` does."""
    from scipy.spatial.transform import Rotation

    path, lines, loads = rows.path, rows.lines, rows.loads(duration)
    if rows.has_matrices:
        R, translations = np.split(rows.matrices(), [3], axis=2)
        errors = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
        rigid = (errors <= _RIGID) & (np.linalg.det(R) > 0)
        for i in np.flatnonzero(~rigid)[:1]:
            raise BadInput(
                f"{path}, line {lines[i]}: expected a rotation in the first three columns of the "
                f"3x4 matrix; R^T R differs from the identity by {errors[i]:.1e}, "
                f"det R = {np.linalg.det(R[i]):g}"
            )
        rotations, translations = Rotation.from_matrix(R), translations[:, :, 0]
        angles = (rotations[:-1].inv() * rotations[1:]).magnitude()
    else:
        turns = set(ROTATION) <= set(rows.names)
        vectors = rows.columns(ROTATION) if turns else np.zeros((len(loads), 3))
        rotations, translations = Rotation.from_rotvec(vectors), rows.columns(TRANSLATION)
        angles = np.linalg.norm(np.diff(vectors, axis=0), axis=1)
    for i in np.flatnonzero(angles >= _HALF_TURN)[:1]:
        raise BadInput(
            f"{path}, line {lines[i + 1]}: a turn of {np.degrees(angles[i]):.0f} degrees from the "
            "row before: expected less than 180, so that its direction is known"
        )
    return PoseTable(loads, rotations.as_matrix(), translations)


def bone_motion(rows: MotionRows, name: str, duration: float | None, rigid: bool) -> Motion:
    """Return the motion of a bone.

    Between two rows, 3x4 matrices are linear in each entry. If they are rigid, and in a file of
    translations and rotation vectors, rotations are slerped and translations linear.

    Parameters
    ----------
    rows : MotionRows
        The rows of a file, of this bone and of others.
    name : str
        The bone.
    duration : float or None
        The length of the run [s], for a file with times.
    rigid : bool
        Whether the matrices are rotations and translations.

    Raises
    ------
    BadInput
        One line, for a file without rows of the bone, with rows that do not reach from the start to
        the end, and for a matrix A whose determinant is not positive, at a row or between two; with
        ``rigid``, for one that is no rotation.
    """
    rows = rows.of_bone(name)
    if rigid or not rows.has_matrices:
        return pose_table(rows, duration)
    table = AffineTable(rows.loads(duration), rows.matrices())
    bad = table.first_singular()
    if bad is not None:
        determinant = np.linalg.det(table.matrices[bad, :, :3])
        where = f"{rows.path}, line {rows.lines[bad]}: bone '{name}'"
        if determinant > 0:
            raise BadInput(
                f"{where}: the entries a11 to a33 are linear from the row before, and their "
                "determinant is not positive between the two: expected rows that are closer, or "
                "rigid = true"
            )
        raise BadInput(
            f"{where}: the determinant of a11 to a33 is {determinant:.3g}: expected one > 0"
        )
    return table
