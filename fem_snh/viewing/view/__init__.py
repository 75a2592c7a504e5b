"""``fem-snh view``: a run as one HTML page: its body in three dimensions, curves, steps, settings.

The page needs no other file and no network: it holds the viewer, which is vtk.js as trame packs it,
and a scene for each state. `fem_snh.viewing.view.page` writes it in a process of its own
(`fem_snh.viewing.worker`).
"""

from __future__ import annotations

from pathlib import Path

from fem_snh.errors import BadInput
from fem_snh.files import output_path
from fem_snh.records.units import Units
from fem_snh.viewing.render import Job, StoredRun
from fem_snh.viewing.render.options import ViewOptions
from fem_snh.viewing.worker import require, run_elsewhere

#: States on a page, at most: each takes about a tenth of a second and 100 kB for 1,000 cells.
MAX_STATES = 13


def main(
    folder: Path,
    out: Path | None = None,
    field: str = "J",
    revolve: bool = False,
    view: ViewOptions | None = None,
) -> Path:
    """Write the page of a run and return its path.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path, optional
        The page; default: ``folder/view.html``.
    field : str
        The field that the colours show, or a component of it: see `fem_snh.viewing.render.main`.
    revolve : bool
        Show an axisymmetric body revolved, in place of its section.
    view : ViewOptions, optional
        Clip plane, hidden parts, and the camera of the page's first view.

    Raises
    ------
    BadInput
        If a package or a file is missing, a file cannot be read, or the page cannot be written.
    """
    folder = Path(folder)
    out = output_path("--out", out) if out is not None else folder / "view.html"
    if out.suffix not in (".html", ".htm"):
        raise BadInput(f"--out {out}: expected a file .html")
    require("view", ("pyvista", "matplotlib"))
    require("view", ("trame_vtk",), "'fem_snh[view]'")
    run = StoredRun(folder, field, view)
    run.check_revolved(revolve)
    states = [run.panel(load) for load in choose_states(list(run.states))]
    units = Units.of(run.record)
    job = Job(field, "", states, str(out), revolve=revolve, view=run.view, units=units)
    run_elsewhere(f"{__name__}.page", "write_page", job, run.record, opengl=True)
    return out


def choose_states(loads: list[float]) -> list[float]:
    """Return at most `MAX_STATES` of the loads, evenly chosen, with the first and the last."""
    if len(loads) <= MAX_STATES:
        return loads
    last, intervals = len(loads) - 1, MAX_STATES - 1
    return [loads[round(k * last / intervals)] for k in range(MAX_STATES)]
