"""CSV files of motions: rows of 3x4 matrices, or of rigid poses, at loads or times."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fem_snh.arrays import Array
from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput, nearest_file, shown, unknown_name
from fem_snh.files import read_text
from fem_snh.geometry.motions import AffineTable, Motion, PoseTable

if TYPE_CHECKING:
    import pandas as pd

TRANSLATION = ["x", "y", "z"]
ROTATION = ["rx", "ry", "rz"]
AFFINE = [f"a{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3, 4)]
#: The column with the name of the bone that a row moves.
BONE = "bone"
_COLUMNS = (
    f"a first column 'load' or 'time', then {', '.join(TRANSLATION)} and, if it turns, "
    f"{', '.join(ROTATION)}; or a11, a12, ..., a34; and 'bone' if the file moves several bones"
)
#: Largest distance of the last load of a table from 1, and of the first from 0: rounded decimals.
_ROUNDED = 1e-9
#: Largest entry of R^T R - I of a rotation: a table of 6 digits has 1e-6 in each entry.
_RIGID = 1e-5
#: Largest rotation between two rows [rad]: the shortest way is not unique at half a turn.
_HALF_TURN = np.pi * (1 - 1e-6)


def read_rows(path: str | Path, bones: Collection[str] = ()) -> pd.DataFrame:
    """Return the rows of a CSV file of motions, with the columns of `read_motion`.

    Values are floats, in the column "bone" strings.

    Parameters
    ----------
    path : str or Path
        The file.
    bones : collection of str
        The names that the column "bone" may have; without any names the file has no such column.

    Raises
    ------
    BadInput
        For a file that cannot be read, wrong columns or numbers, or an unknown bone.
    """
    import pandas as pd  # takes longer to import than scenes without files to read

    path = Path(path)
    try:
        text = StringIO(read_text(path, encoding="utf-8-sig"))
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of rows that are longer than the first
            table = pd.read_csv(
                text, skipinitialspace=True, comment="#", index_col=False, dtype=str,
                keep_default_na=False,
            )  # fmt: skip
    except OSError as error:
        near = nearest_file(path)
        raise BadInput(f"cannot read the motion {path}: {error.strerror}{near}") from None
    except (ValueError, Warning) as error:
        raise BadInput(f"motion = '{path}': expected a CSV file of UTF-8 text: {error}") from None
    table = table.rename(columns=str.strip).apply(lambda cells: cells.astype(str).str.strip())
    names = [name for name in table if name != BONE or not bones]
    accepted = [sorted(group) for group in (TRANSLATION, TRANSLATION + ROTATION, AFFINE)]
    if names[:1] not in (["load"], ["time"]) or sorted(names[1:]) not in accepted:
        raise BadInput(f"motion = '{path}': expected the columns: {_COLUMNS}")
    for name in names:
        cells = table[name]
        table[name] = pd.to_numeric(cells, errors="coerce").astype(float)
        for row in np.flatnonzero(~(table[name].abs() <= LARGEST_NUMBER))[:1]:
            raise BadInput(
                f"motion = '{path}', row {row + 1}: {name} = '{cells[row]}': expected a number of "
                f"a size up to {LARGEST_NUMBER:g}"
            )
    for name in set(table.get(BONE, ())) - {*bones}:
        raise BadInput(f"motion = '{path}': {unknown_name('bone', name, list(bones))}")
    return table


def _loads(path: str | Path, table: pd.DataFrame, duration: float | None) -> Array:
    """Return the load of each row; times are divided by the duration [s].

    Raises BadInput for times without a duration, and unless loads ascend from 0 to 1.
    """
    name = "time" if "time" in table else "load"
    if name == "time" and duration is None:
        raise BadInput(
            f"motion = '{path}': expected a column 'load' instead of 'time', as the scene has no "
            "[time]"
        )
    given = table[name].to_numpy(float)
    end = float(duration) if name == "time" and duration else 1.0
    loads = given / end
    ascends = len(given) > 1 and bool((np.diff(loads) > 0).all())
    if not ascends or loads[0] > _ROUNDED or loads[-1] < 1 - _ROUNDED:
        raise BadInput(
            f"motion = '{path}': {name} = {shown(given.tolist())}: expected two rows or more, "
            f"ascending from 0 to the end of the run, {end:g}"
        )
    return loads


def read_motion(path: str | Path, duration: float | None = None) -> PoseTable:
    """Read a rigid motion from a CSV file with a line of column names.

    Parameters
    ----------
    path : str or Path
        The file. Its first column is ``load`` or ``time``; then a translation ``x, y, z`` and a
        rotation vector ``rx, ry, rz`` (axis times angle [rad], about the origin, before the
        translation; may be left out), or the entries ``a11, a12, ..., a34`` of a 3x4 matrix
        [R | c], row by row. # begins a comment.
    duration : float, optional
        The time [s] at which the load is 1, for a file with times.

    Raises
    ------
    BadInput
        As `read_rows`; and for times or loads that do not ascend or do not cover the run, a matrix
        that is not a rotation and a translation, or half a turn or more between two rows.
    """
    return _pose_table(path, read_rows(path), duration)


def _pose_table(path: str | Path, table: pd.DataFrame, duration: float | None) -> PoseTable:
    """Return the rigid motion in the rows of a file. Raises BadInput as `read_motion` does."""
    from scipy.spatial.transform import Rotation

    loads = _loads(path, table, duration)
    if AFFINE[0] in table:
        R, c = np.split(_matrices(table), [3], axis=2)
        errors = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
        for row in np.flatnonzero((errors > _RIGID) | (np.linalg.det(R) < 0))[:1]:
            raise BadInput(
                f"motion = '{path}', row {row + 1}: expected a rotation in the first three columns "
                f"of the 3x4 matrix; R^T R differs from the identity by {errors[row]:.1e}, "
                f"det R = {np.linalg.det(R[row]):g}"
            )
        rotations, translations = Rotation.from_matrix(R), c[:, :, 0]
        angles = (rotations[:-1].inv() * rotations[1:]).magnitude()
    else:
        vectors = table.reindex(columns=ROTATION, fill_value=0.0).to_numpy()
        rotations, translations = Rotation.from_rotvec(vectors), table[TRANSLATION].to_numpy()
        angles = np.linalg.norm(np.diff(vectors, axis=0), axis=1)
    for row in np.flatnonzero(angles >= _HALF_TURN)[:1]:
        raise BadInput(
            f"motion = '{path}', row {row + 2}: a turn of {np.degrees(angles[row]):.0f} degrees "
            "from the row before: expected less than 180, so that its direction is known"
        )
    return PoseTable(loads, rotations.as_matrix(), translations)


def _matrices(table: pd.DataFrame) -> Array:
    """Return the matrices [A | c] of a table with these columns, (rows, 3, 4)."""
    return table[AFFINE].to_numpy().reshape(-1, 3, 4)


def bone_motion(
    path: str | Path, table: pd.DataFrame, name: str, duration: float | None, rigid: bool
) -> Motion:
    """Return the motion of a bone from the rows of a file.

    Between two rows, the entries of 3x4 matrices are linear. With ``rigid``, and for translations
    and rotation vectors, rotations are slerped instead, and translations are linear.

    Parameters
    ----------
    path : str or Path
        The file, for messages.
    table : DataFrame
        The rows of all bones: see `read_rows`.
    name : str
        The bone.
    duration : float or None
        The time [s] at which the load is 1, for a file with times.
    rigid : bool
        Whether to require that matrices are rotations and translations.

    Raises
    ------
    BadInput
        For a file without rows of the bone, or with rows that do not cover the run; with ``rigid``,
        for a matrix that is no rotation.
    """
    if BONE in table:
        table = table[table[BONE] == name].reset_index(drop=True)
        if table.empty:
            raise BadInput(f"motion = '{path}': expected rows of bone '{name}'")
    if rigid or AFFINE[0] not in table:
        return _pose_table(path, table, duration)
    return AffineTable(_loads(path, table, duration), _matrices(table))
