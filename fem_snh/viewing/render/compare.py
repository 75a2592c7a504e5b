"""Draw several runs side by side, one body each; studies and benchmarks call it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fem_snh.errors import BadInput
from fem_snh.viewing import render
from fem_snh.viewing.render.records import common_units, material_name

#: What separates the parts of a label.
_DOT = "  ·  "


def main(
    folders: Sequence[Path],
    out: Path,
    load: float | Sequence[float] | None = None,
    labels: Sequence[str] | None = None,
    field: str = "J",
) -> Path:
    """Draw the bodies of runs side by side, with one scale and colour map, and return the PNG.

    Parameters
    ----------
    folders : sequence of Path
        Folders of the runs, one panel each.
    load : float or sequence of float, optional
        In 0..1, of all runs or of each; default: the last one that each has stored.
    labels : sequence of str, optional
        Labels of the panels, before load and volume; default: the names of the materials. What
        all panels share is in the title.
    field : str
        As for `fem_snh.viewing.render.main`.

    Raises
    ------
    BadInput
        As from `fem_snh.viewing.render.main`.
    """
    out = render.picture_path(out)
    runs = [render.StoredRun(folder, field) for folder in folders]
    if not runs:
        raise BadInput("nothing to draw: give folders of runs")
    names = labels or [material_name(run.record) for run in runs]
    loads = load if isinstance(load, Sequence) else [load] * len(folders)
    panels = []
    for run, name, at in zip(runs, names, loads, strict=True):
        stored = list(run.states)
        panel = run.panel(*render.choose_loads(stored, [stored[-1] if at is None else at]))
        panels.append(replace(panel, label=f"{name}{_DOT}{panel.label}"))
    title = _common([render.title(run.record) for run in runs])
    if len(panels) > 1:
        shared = _common([panel.label for panel in panels])
        for index, panel in enumerate(panels):
            own = [part for part in panel.label.split(_DOT) if part not in shared]
            panels[index] = replace(panel, label=_DOT.join(own))
        title += [part for part in shared if part not in title]
    units = common_units([run.record for run in runs])
    render.draw(render.Job(field, _DOT.join(title), panels, str(out), units=units))
    return out


def _common(texts: Sequence[str]) -> list[str]:
    """Return the parts that all texts have."""
    parts = [text.split(_DOT) for text in texts]
    return [part for part in parts[0] if all(part in other for other in parts)]
