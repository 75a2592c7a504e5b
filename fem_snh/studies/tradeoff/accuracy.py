"""Choose the settings of a run for a required accuracy, from the table of a study: advice.csv.

The folder ``tables`` holds the tables of built-in scenes.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.files import file_digest, read_text
from fem_snh.studies.tradeoff.errors import error_bound
from fem_snh.studies.tradeoff.knobs import AUTOMATIC, KNOBS, Choice


@dataclass(frozen=True)
class Chosen:
    """The settings of one row of a table.

    Parameters
    ----------
    table : str
        Name of the table.
    nu : float
        Poisson's ratio of the measurement.
    choice : Choice
        Its settings.
    error : float
        Upper bound of the relative error of the displacement.
    cpu : float
        Processor time [s].
    """

    table: str
    nu: float
    choice: Choice
    error: float
    cpu: float

    def values(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values for `fem_snh.scenes.load` that are not ``given`` already.

        Raises
        ------
        BadInput
            If a given value differs from that of the row.
        """
        mine = self.choice.values()
        for key, value in given.items():
            if key in mine and value is not None and value != mine[key]:
                raise BadInput(
                    f"{key} = {value} contradicts --accuracy, which sets {key} = {mine[key]} "
                    f"({self.table}, nu = {self.nu:g}): expected one of the two"
                )
        return mine

    def changes(self, own: scenes.Scene) -> dict[str, list[Any]]:
        """Return what the settings change in a scene: {key: [its value, the new one]}."""
        found = {}
        for key, value in self.choice.values().items():
            name, _, option = key.partition(".")
            before = own.petsc.get(option) if option else getattr(own, name)
            before = before if isinstance(before, int | float | None) else str(before)
            if before != value:
                found[key] = [before, value]
        return found

    def record(self, asked: float, changed: Mapping[str, Any]) -> dict[str, Any]:
        """Return the entry ``accuracy`` of run.json; ``changed`` is that of `changes`."""
        knobs = {key: getattr(self.choice, key) for key in ("element", "cells", *KNOBS)}
        found = {"asked": asked, "table": self.table, "nu": self.nu, "error": self.error}
        found |= {"processor_seconds": self.cpu, "changed": dict(changed)}
        return {"accuracy": found | knobs}

    def message(self) -> str:
        """Return a line for the terminal."""
        choice, where = self.choice, self.choice.mesh or f"{self.choice.cells} cells"
        named = [word for word in (choice.hessian, choice.solver) if word != AUTOMATIC]
        return (
            f"accuracy: {', '.join([choice.element, where, *named])}: measured "
            f"error <= {100 * self.error:.2g} % in {self.cpu:.2g} s of processor time at nu = "
            f"{self.nu:g} ({self.table})"
        )


def fraction(text: Any) -> float:
    """Return an accuracy as a fraction, from 0.01, "1%" or "1 %"; raise BadInput otherwise."""
    word = str(text).strip()
    try:
        number = float(word.removesuffix("%")) / (100 if word.endswith("%") else 1)
    except ValueError:
        number = float("nan")
    if not 0 < number < 1:
        raise BadInput(f"accuracy = {text}: expected per cent or a fraction, e.g. 1% or 0.01")
    return number


def changes_message(changed: Mapping[str, Sequence[Any]]) -> str:
    """Return a line for the terminal with every setting that is changed, or ""."""
    words = [
        f"{key} = {new}" + (f" for {old}" if old is not None else "")
        for key, (old, new) in changed.items()
    ]
    return f"accuracy: changes of the scene: {', '.join(words)}" if words else ""


def choose(
    scene: str,
    nu: float,
    accuracy: float,
    table: Path | None = None,
    own: scenes.Scene | None = None,
) -> Chosen:
    """Return the cheapest settings within ``accuracy``, measured at the next nu at or above ``nu``.

    Parameters
    ----------
    accuracy : float
        Relative error of the displacement.
    table : Path, optional
        An advice.csv or tradeoff.csv; None: that of the built-in scene.
    own : Scene, optional
        The scene, of which the table must be.

    Raises
    ------
    BadInput
        If there is no table, it is that of another scene or mesh, has no such nu, or no row so
        accurate.
    """
    name, rows = _rows(scene, table)
    if table is not None and own is not None:
        _check_scene(table, rows, own)
    nus = sorted({row["nu"] for row in rows})
    if not nus or nu > nus[-1]:
        there = f"up to {nus[-1]:g}" if nus else "no nu with an error"
        raise BadInput(
            f"accuracy: {name} has {there}, not nu = {nu:g}: "
            f"see `fem-snh tradeoff {scene} --nu {nu:g}`"
        )
    at = next(measured for measured in nus if measured >= nu)
    mine = [row for row in rows if row["nu"] == at]
    within = [row for row in mine if row["error"] <= accuracy]
    if not within:
        best = min(row["error"] for row in mine)
        raise BadInput(
            f"accuracy = {100 * accuracy:g} %: the best of {name} at nu = {at:g} is "
            f"{100 * best:.2g} %; see `fem-snh tradeoff {scene} --nu {nu:g}` for finer meshes"
        )
    row = min(within, key=lambda row: float(row["cpu"]))
    return Chosen(name, at, row["choice"], row["error"], row["cpu"])


def _check_scene(table: Path, rows: Sequence[Mapping[str, Any]], own: scenes.Scene) -> None:
    """Raise BadInput unless a table was measured for a scene, and for its mesh."""
    others = sorted({row["scene"] for row in rows} - {own.name})
    if others:
        raise BadInput(
            f"accuracy-table {table}: it is of the scene {others[0]}, not of {own.name}: expected "
            "a table that `fem-snh tradeoff` has made for this scene"
        )
    meshes = sorted({row["choice"].mesh for row in rows} - {""})
    if not isinstance(own.mesh, Path):
        if meshes:
            raise BadInput(
                f"accuracy-table {table}: it is of mesh files, {meshes[-1]}, and {own.name} "
                "generates its mesh: expected a table of this scene"
            )
        return
    known = {_digest(Path(mesh)) for mesh in meshes} | _studied_digests(table)
    if _digest(own.mesh) not in known:
        raise BadInput(
            f"accuracy-table {table}: mesh = {own.mesh}: expected the mesh that the scene had in "
            f"the study (tradeoff.json beside the table), or one of {', '.join(meshes) or 'none'}"
        )


def _digest(path: Path) -> str | None:
    """Return the digest of a file; None if it is not there."""
    return file_digest(path) if path.is_file() else None


def _studied_digests(table: Path) -> set[str]:
    """Return the digests of the files of a study's scene, from tradeoff.json beside its table."""
    try:
        definition = json.loads((table.parent / "tradeoff.json").read_text(encoding="utf-8"))
        return set(definition["files"].values())
    except (OSError, ValueError, KeyError, AttributeError, TypeError):
        return set()  # a table without its study, or another file of this name


def _rows(scene: str, table: Path | None) -> tuple[str, list[dict[str, Any]]]:
    """Return the name of the table and its rows that have an error."""
    if table is not None:
        try:
            return str(table), _parse(read_text(table), str(table))
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
            raise BadInput(f"accuracy-table {table} cannot be read: {reason}") from None
    packaged = resources.files(__package__) / "tables"
    there = sorted(
        p.name.removesuffix(".csv") for p in packaged.iterdir() if p.name.endswith(".csv")
    )
    if scene not in there:
        raise BadInput(
            f"accuracy: there is no table for {scene}, only for {', '.join(there)}; make one with "
            f"`fem-snh tradeoff {scene} --out DIR` and give --accuracy-table DIR/advice.csv"
        )
    path = packaged / f"{scene}.csv"
    return f"{scene}.csv", _parse(path.read_text(encoding="utf-8"), f"{scene}.csv")


def _parse(text: str, name: str) -> list[dict[str, Any]]:
    """Return the rows of an advice.csv or tradeoff.csv that have an error, as numbers."""
    reader = csv.DictReader(io.StringIO(text))
    columns = reader.fieldnames or ()
    error = "error" if "error" in columns else "error_displacement"
    more = () if error == "error" else ("floor_displacement", "shift")
    needed = ("scene", "nu", "element", "cells", *KNOBS, "cpu", error, *more)
    if missing := [column for column in needed if column not in columns]:
        raise BadInput(f"accuracy-table {name}: has no column {', '.join(missing)}")
    rows = []
    for line in reader:
        if not line[error]:
            continue
        try:
            known = {key: float(line[key]) for key in ("nu", "cpu", error, *more)}
            known["error"] = error_bound(known) if more else known["error"]
            rows.append({**known, "scene": line["scene"], "choice": _choice(line)})
        except (TypeError, ValueError) as wrong:
            raise BadInput(f"accuracy-table {name}, line {reader.line_num}: {wrong}") from None
    return rows


def _choice(line: Mapping[str, str]) -> Choice:
    """Return the settings of a row."""
    cells = line.get("cells")
    return Choice(
        line["element"],
        int(float(cells)) if cells else None,
        line.get("mesh") or "",
        hessian=line["hessian"],
        solver=line["solver"],
        forcing=float(line["forcing"]),
        tolerance=float(line["tolerance"]),
        steps=int(float(line["steps"])) if line.get("steps") else None,
    )
