"""A case: what is run, what is asked of it, and whether it must hold."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from fem_snh import scenes
from fem_snh.studies.campaign import Point
from fem_snh.studies.scene_points import ScenePoint
from fem_snh.studies.table import ASKED, FOUND, last_words

#: A case's record (empty if it left none) and its row.
Record = Mapping[str, Any]
Row = Mapping[str, Any]
#: Why a case does not hold, in words; nothing if it holds.
Check = Callable[[Record, Row], str]

#: What every row of the table has.
COLUMNS = (
    "point", "family", "asked", "must", "holds", "why",
    *ASKED, "seed", "ranks", *FOUND, "max_u", "nonfinite",
)  # fmt: skip


#: Seconds for a case that is only there to be compared.
_COMPARED = 200.0


@dataclass(frozen=True)
class Case:
    """One row of the study.

    Attributes:
        name: of its folder: unique, its family first.
        asked: what it is to do, in words.
        point: what runs.
        check: of a run that came to its end.
        must: whether the study fails if it does not hold; if not, it is there to be compared.
    """

    name: str
    asked: str
    point: Point
    check: Check
    must: bool = True

    @property
    def family(self) -> str:
        return self.name.partition("-")[0]

    def judged(self, record: Record, row: Row) -> dict[str, Any]:
        """Whether it holds, and why not: the columns ``holds`` and ``why``."""
        why = self.check(record, row) if record else str(row["status"])
        return {"holds": not why, "why": why}


def run_of(
    scene: str, name: str, asked: str, check: Check, *, must: bool = True, **values: Any
) -> Case:
    """A case that is a run of a scene, with values as `fem_snh.scenes.load` takes them."""
    family = name.partition("-")[0]
    columns = {"family": family, "asked": asked, "must": must, "seed": values.get("seed")}
    loaded = _loaded(scene, json.dumps({k: v for k, v in values.items() if k != "seed"}))
    point = ScenePoint(scene, values, loaded, columns=columns, timeout=None if must else _COMPARED)
    return Case(name, asked, point, check, must)


@cache
def _loaded(scene: str, values: str) -> scenes.Scene:
    """A scene as its row needs it: no column depends on the seed, and loading takes its time."""
    return scenes.load(scene, **json.loads(values))


def converged(record: Record, row: Row) -> str:
    """It came to load 1, in the steps asked for."""
    if row["converged"] is not True:
        return str(row["status"])
    attempted = len(record["steps"])
    return f"{attempted} steps instead of {row['steps']}" if attempted > row["steps"] else ""


def at_rest(record: Record, row: Row) -> str:
    """No point is further than 1e-6 of the side (of a unit cube) from where it was at rest."""
    why = converged(record, row)
    if why or row["max_u"] < 1e-6:
        return why
    return (
        f"another equilibrium: max |u| {row['max_u']:.2g}, energy {row['energy']:.2g}, "
        f"min J {row['min_J']:.2f}"
    )


@dataclass(frozen=True)
class OwnPoint(Point):
    """A case of a family that is no run of a scene, by ``python -m fem_snh.studies.extremes``.

    It leaves rows (tables with ``holds`` and what else is measured). One row's own ``status``,
    ``newton``, ``linear`` and the like are the case's; of several it is told how many hold.
    """

    family: str
    case: str
    quick: bool

    module = "fem_snh.studies.extremes"
    parallel = False
    record = "record.json"

    def words(self, folder: Path) -> list[str]:
        return [self.family, self.case, str(folder), *(["--quick"] if self.quick else [])]

    def asked(self) -> Mapping[str, Any]:
        return {}

    def found(self, record: Record, log: Path, code: int) -> Mapping[str, Any]:
        rows = record.get("rows", []) if code == 0 else []
        if not rows:
            return {"status": last_words(log, code), "seconds": record.get("seconds")}
        row = dict(rows[0]) if len(rows) == 1 else {}
        good = sum(bool(r["holds"]) for r in rows)
        row.setdefault("status", f"{good} of {len(rows)} hold")
        row.setdefault("seconds", record["seconds"])
        return row


def all_hold(record: Record, row: Row) -> str:
    """Every row of the record holds; if not, those that do not, by their texts."""
    bad = [r for r in record["rows"] if not r["holds"]]
    named = [" ".join(str(v) for v in r.values() if isinstance(v, str)) for r in bad[:3]]
    more = f" and {len(bad) - 3} more" if len(bad) > 3 else ""
    return ("; ".join(named) or str(row["status"])) + more if bad else ""


def own(family: str, case: str, asked: str, quick: bool) -> Case:
    """A case of `OwnPoint`."""
    columns = {"family": family, "asked": asked, "must": True}
    point = OwnPoint(family, case, quick, columns=columns)
    return Case(f"{family}-{case}", asked, point, all_hold)
