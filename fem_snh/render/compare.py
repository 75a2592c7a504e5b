"""Draw several runs side by side, one body each; studies and benchmarks call it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fem_snh import render
from fem_snh.errors import BadInput
from fem_snh.render.fields import check_field
from fem_snh.render.records import material_name


def main(
    folders: Sequence[Path],
    out: Path,
    load: float | None = None,
    labels: Sequence[str] | None = None,
    field: str = "J",
) -> Path:
    """Draw the bodies of runs side by side, with one scale and colour map, and return the PNG.

    Parameters
    ----------
    folders : sequence of Path
        Folders of the runs, one panel each.
    load : float, optional
        In 0..1; default: the last one that each run has stored.
    labels : sequence of str, optional
        Labels of the panels, before load and volume; default: the names of the materials.
    field : str
        As for `fem_snh.render.main`.

    Raises
    ------
    BadInput
        As from `fem_snh.render.main`.
    """
    folders = [Path(folder) for folder in folders]
    records = [render.read_record(folder) for folder in folders]
    if not records:
        raise BadInput("nothing to draw: give folders of runs")
    names = labels or [material_name(record) for record in records]
    panels = []
    for folder, record, name in zip(folders, records, names, strict=True):
        stored = render.stored_loads(folder / "fields.pvd")
        check_field(folder / "fields.pvd", field)
        (at,) = render.choose_loads(sorted(stored), [max(stored) if load is None else load])
        label = f"{name}  ·  {render.panel_label(record, at)}"
        panels.append(render.Panel([str(file) for file in stored[at]], label))
    titles = [render.title(record).split("  ·  ") for record in records]
    common = [part for part in titles[0] if all(part in other for other in titles)]
    render.draw(render.Job(field, "  ·  ".join(common), panels, str(out)))
    return Path(out)
