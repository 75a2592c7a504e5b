"""A scene for every combination of some values: one process per point, one row per point.

    >>> table = sweep("twist", "out/nu", {"nu": [0.3, 0.45, 0.49], "cells": 6}, jobs=2)

The folder holds sweep.json (what was asked), sweep.csv (a row the moment a point ends), sweep.png
and a run folder for each point with its log. Call it again and it goes on where it was ended.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fem_snh import scenes
from fem_snh.studies.campaign import Campaign, Limits
from fem_snh.studies.scene_points import ScenePoint, digests, text
from fem_snh.studies.table import ASKED, FOUND

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
    memory: float | None = None,
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
        memory: GiB of RAM above which it is.
        retry: run the failed points of an earlier call again.
        overwrite: begin anew, whatever ``out`` holds of an earlier sweep.
        petsc: PETSc options for every point, without the dash.
        report: gets one line per point.

    Raises:
        BadInput: before anything runs: a bad value, or another sweep in ``out``.
    """
    limits = Limits(jobs, ranks, timeout, memory)
    lists = {key: list(v) if isinstance(v, list | tuple) else [v] for key, v in axes.items()}
    options = dict(petsc or {})
    points = {
        name: ScenePoint(scene, values, scenes.load(scene, **values), options)
        for name, values in combinations(lists).items()
    }
    files = digests(scene, (point.scene for point in points.values()))
    extra = [key for key in lists if key not in (*ASKED, *FOUND)]
    campaign = Campaign(
        Path(out),
        "sweep",
        {"scene": str(scene), "axes": lists, "files": files, "petsc": options},
        ["point", *ASKED, *extra, "ranks", *FOUND],
        limits,
        retry=retry,
        overwrite=overwrite,
        report=report,
    )
    campaign.run(points)
    campaign.draw()
    import pandas as pd

    return pd.read_csv(campaign.table.path)


def combinations(lists: Mapping[str, list[Any]]) -> dict[str, dict[str, Any]]:
    """Every point by the name of its folder, which tells the values that differ between points."""
    points = {}
    for chosen in itertools.product(*lists.values()):
        values = dict(zip(lists, chosen, strict=True))
        words = [f"{key}={text(v)}" for key, v in values.items() if len(lists[key]) > 1]
        points[folder_name(words) or "point"] = values
    return points


def folder_name(words: list[str]) -> str:
    """Words as one that a file system takes."""
    return re.sub(r"[^\w.=+-]+", "_", "__".join(words))
