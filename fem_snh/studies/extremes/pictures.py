"""Pictures of runs and columns of counts for the page of the study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from fem_snh.errors import BadInput
from fem_snh.viewing import render


@dataclass(frozen=True)
class Picture:
    """A picture of the page.

    Parameters
    ----------
    path : Path
        Path of the file, in the study's folder.
    caption : str
        The text below it.
    draw : callable
        Draws the file; raises BadInput if it cannot.
    """

    path: Path
    caption: str
    draw: Callable[[], object]

    def markdown(self, links: str = "") -> str:
        """Draw the picture, if its runs exist, and return its Markdown."""
        try:
            self.draw()
        except BadInput as error:
            if not self.path.exists():
                return f"(no picture {self.path.name}: {error})"
        return f"![{self.caption}]({links}{self.path.name})\n\n*{self.caption}*"


def body_picture(
    out: Path, file: str, panels: Sequence[tuple[str, float, str]], caption: str
) -> Picture:
    """Return a picture of deformed bodies coloured by J, a panel for each (case, load, label)."""

    def draw() -> None:
        drawn = []
        for case, load, label in panels:
            stored = render.stored_loads(out / case / "fields.pvd")
            (nearest,) = render.choose_loads(sorted(stored), [load])
            record = render.read_record(out / case)
            panel = render.panel(record, out / case, stored[nearest], nearest)
            drawn.append(replace(panel, label=label))
        record = render.read_record(out / panels[0][0])
        render.draw(render.Job("J", render.title(record), drawn, str(out / file)))

    return Picture(out / file, caption, draw)


#: The columns of `counts`.
COUNTS = ("passed", "Newton: median", "worst", "linear: median", "NaN seen", "seconds: median")


def counts(rows: pd.DataFrame) -> list[str]:
    """Return the cells of the columns `COUNTS` for a group of rows."""
    numbers = rows[["newton", "linear", "nonfinite", "seconds"]].apply(pd.to_numeric)
    median, worst = numbers.median(), numbers.max()
    return [
        f"{rows['passed'].sum()} of {len(rows)}",
        _count(median["newton"]),
        _count(worst["newton"]),
        _count(median["linear"]),
        _count(numbers["nonfinite"].sum()),
        f"{median['seconds']:.1f}",
    ]


def _count(number: float) -> str:
    return "-" if number != number else f"{number:,.0f}"
