"""What the families' parts of the page share: counts in a table's line, pictures of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from fem_snh import render
from fem_snh.errors import BadInput


@dataclass(frozen=True)
class Picture:
    """A file in the study's folder, what stands below it, and how it is made."""

    file: str
    caption: str
    draw: Callable[[], Path]

    def markdown(self) -> str:
        """The picture, drawn; or why there is none."""
        try:
            self.draw()
        except BadInput as error:
            return f"(no picture {self.file}: {error})"
        return f"![{self.caption}]({self.file})\n\n*{self.caption}*"


def bodies(out: Path, file: str, panels: Sequence[tuple[str, float, str]], caption: str) -> Picture:
    """The bodies of cases, coloured by J: a panel for each (case, load, label)."""

    def draw() -> Path:
        shown = []
        for case, load, label in panels:
            stored = render.stored_loads(out / case / "fields.pvd")
            (at,) = render.choose_loads(sorted(stored), [load])
            shown.append(render.Panel([str(piece) for piece in stored[at]], label))
        record = render.read_record(out / panels[0][0])
        render.draw_elsewhere(render.Job("J", render.title(record), shown, str(out / file)))
        return out / file

    return Picture(file, caption, draw)


class _Counts:
    """Columns about a group of rows: how many hold, Newton iterations, and what they met."""

    head = ("hold", "Newton: median", "worst", "linear: median", "NaN seen", "seconds: median")

    def __call__(self, rows: pd.DataFrame) -> list[str]:
        numbers = rows[["newton", "linear", "nonfinite", "seconds"]].apply(pd.to_numeric)
        median, worst = numbers.median(), numbers.max()
        return [
            f"{rows['holds'].sum()} of {len(rows)}",
            _count(median["newton"]),
            _count(worst["newton"]),
            _count(median["linear"]),
            _count(numbers["nonfinite"].sum()),
            f"{median['seconds']:.1f}",
        ]


counts = _Counts()


def _count(number: float) -> str:
    return "-" if number != number else f"{number:,.0f}"
