"""A scene for every combination of some values: one process per point, one row per point.

    >>> table = sweep("twist", "out/nu", {"nu": [0.3, 0.45, 0.49], "cells": 6}, jobs=2)

The folder holds sweep.json (what was asked), sweep.csv (a row the moment a point ends), sweep.png
and a run folder for each point with its log. Call it again and it goes on where it was ended.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.studies.processes import Child, environment, program
from fem_snh.studies.table import ASKED, FOUND, Table, found, write_whole

if TYPE_CHECKING:
    import pandas as pd


def sweep(
    scene: str | Path,
    out: str | Path,
    axes: Mapping[str, Any],
    *,
    jobs: int = 1,
    ranks: int = 1,
    timeout: float | None = None,
    retry: bool = False,
    overwrite: bool = False,
    petsc: Mapping[str, Any] | None = None,
    report: Callable[[str], None] = print,
) -> pd.DataFrame:
    """Run every combination of ``axes`` and return the table: sweep.csv, one row per point.

    A point that fails (does not converge, crashes, takes too long) is a row with its reason, and
    the others go on.

    Args:
        scene: a name or a .toml file.
        out: the folder; a sweep that was begun there goes on.
        axes: a list of values (or one value) for each key, as `fem_snh.scenes.load` knows them.
        jobs: points at a time.
        ranks: MPI ranks of each point.
        timeout: seconds after which a point is given up.
        retry: run the failed points of an earlier call again.
        overwrite: begin anew, whatever ``out`` holds of an earlier sweep.
        petsc: PETSc options for every point, without the dash.
        report: gets one line per point.

    Raises:
        BadInput: before anything runs: a bad value, or another sweep in ``out``.
    """
    out = Path(out)
    for key, count in {"jobs": jobs, "ranks": ranks}.items():
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise BadInput(f"{key} = {count}: expected a whole number, 1 or more")
    if timeout is not None and not (isinstance(timeout, int | float) and timeout > 0):
        raise BadInput(f"timeout = {timeout}: expected seconds, a number > 0")
    lists = {key: list(v) if isinstance(v, list | tuple) else [v] for key, v in axes.items()}
    points = combinations(lists)
    loaded = {name: scenes.load(scene, **values) for name, values in points.items()}
    start = program(ranks)
    options = dict(petsc or {})
    files = {f for f in (Path(scene), *(s.mesh for s in loaded.values())) if isinstance(f, Path)}
    definition = {"scene": str(scene), "axes": lists, "ranks": ranks, "petsc": options}
    definition["files"] = {str(f): _digest(f) for f in sorted(files) if f.suffix}
    _prepare(out, definition, overwrite)

    extra = [key for key in lists if key not in (*ASKED, *FOUND)]
    table = Table(out / "sweep.csv", ["point", *ASKED, *extra, "ranks", *FOUND])
    if retry:
        table.drop(row["point"] for row in table.rows() if row["converged"] != "True")
    done = {row["point"] for row in table.rows()}
    waiting = [name for name in points if name not in done]
    running: dict[str, Child] = {}
    if done:
        report(f"{len(done)} of {len(points)} points are there already")
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                name = waiting.pop(0)
                folder = out / name
                shutil.rmtree(folder, ignore_errors=True)  # left by a point that was cut off
                folder.mkdir(parents=True)
                command = [*start, *arguments(scene, folder, points[name], options)]
                running[name] = Child(command, folder / "log.txt", timeout)
            for name in [name for name in running if running[name].poll() is not None]:
                child = running.pop(name)
                row = {"point": name, "ranks": ranks} | points[name] | _asked(loaded[name])
                row |= found(out / name, child.poll() or 0)
                row["seconds"] = row["seconds"] or child.seconds
                if child.timed_out:
                    row["status"] = f"given up after {timeout:g} s"
                table.append(row)
                done.add(name)
                report(
                    f"[{len(done)}/{len(points)}] {name}: {row['status']}, {child.seconds:.1f} s"
                )
            time.sleep(0.02)
    finally:
        for child in running.values():
            child.end()
    _draw(out, report)
    import pandas as pd

    return pd.read_csv(table.path)


def combinations(lists: Mapping[str, list[Any]]) -> dict[str, dict[str, Any]]:
    """Every point by the name of its folder, which tells the values that differ between points."""
    points = {}
    for chosen in itertools.product(*lists.values()):
        values = dict(zip(lists, chosen, strict=True))
        words = [f"{key}={_text(v)}" for key, v in values.items() if len(lists[key]) > 1]
        points[re.sub(r"[^\w.=+-]+", "_", "__".join(words)) or "point"] = values
    return points


def arguments(
    scene: str | Path, folder: Path, values: Mapping[str, Any], petsc: Mapping[str, Any]
) -> list[str]:
    """The words after ``fem-snh`` for one point."""
    words = ["run", str(scene), "--out", str(folder), "--quiet"]
    words += [f"--set={key}={json.dumps(v)}" for key, v in values.items()]
    options = [[f"-{k}"] if v is None else [f"-{k}", _text(v)] for k, v in petsc.items()]
    return [*words, "--", *itertools.chain(*options)]


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _asked(scene: scenes.Scene) -> dict[str, Any]:
    values = {key: getattr(scene, key) for key in ASKED if key not in ("scene", "E", "nu")}
    material = scene.material
    return values | {
        "scene": scene.name, "material": material.name, "E": material.E, "nu": material.nu
    }  # fmt: skip


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _prepare(out: Path, definition: dict[str, Any], overwrite: bool) -> None:
    """Make ``out`` ready for this sweep, or for going on with it. BadInput if it holds another."""
    record = out / "sweep.json"
    definition = json.loads(json.dumps(definition))
    try:
        earlier = json.loads(record.read_text(encoding="utf-8")) if record.exists() else None
    except ValueError:
        earlier = {}
    if earlier is not None and earlier != definition:
        if not overwrite:
            other = [key for key in definition if earlier.get(key) != definition[key]]
            raise BadInput(
                f"{out} holds a sweep with other {', '.join(other)}: "
                "take another folder, or --overwrite it"
            )
    if overwrite and earlier:
        for name in combinations(earlier["axes"]):
            shutil.rmtree(out / name, ignore_errors=True)
        (out / "sweep.csv").unlink(missing_ok=True)
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_whole(record, json.dumps(definition, indent=1))
    except OSError as error:
        raise BadInput(f"cannot write into {out}: {error.strerror}") from None


def _draw(out: Path, report: Callable[[str], None]) -> None:
    """sweep.png, by a process of its own: a table without its picture is still a result."""
    command = [*program(1), "plot", str(out / "sweep.csv"), "--out", str(out / "sweep.png")]
    drawn = subprocess.run(command, env=environment(), capture_output=True, text=True)
    said = (drawn.stdout if drawn.returncode == 0 else drawn.stderr).strip().splitlines()
    report(said[-1] if said else f"no picture: exit code {drawn.returncode}")
