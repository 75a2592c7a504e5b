"""A movie of the deforming body, smooth over the load, from the states that a run has stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fem_snh.atomic_files import output_path
from fem_snh.errors import BadInput, bad_value
from fem_snh.units import Units
from fem_snh.viewing.render import Job, Panel, StoredRun, check_opacity, title
from fem_snh.viewing.render.options import ViewOptions
from fem_snh.viewing.render.records import load_name, load_unit, obstacle_poses, parameter
from fem_snh.viewing.render.worker import draw_elsewhere, require

#: File types, and the packages that write them beside matplotlib's Pillow.
TYPES: dict[str, tuple[str, ...]] = {".mp4": ("imageio", "imageio_ffmpeg"), ".gif": ()}
FRAMES_PER_SECOND = 25
#: Bounds of a movie's length [s]; the upper one is 15,000 frames.
MIN_SECONDS, MAX_SECONDS = 0.1, 600.0
#: Upper bound of the time that a frame takes to draw [s], after which the process counts as hung.
_FRAME_TIMEOUT = 60.0


@dataclass(frozen=True)
class MovieJob(Job):
    """The input of the drawing process `fem_snh.viewing.render.frames`.

    The panels are the stored states; ``names`` are the values of the load parameter there, and
    ``obstacles`` those of the run at all its loads.
    """

    names: list[float] = field(default_factory=list)
    load_name: str = ""
    load_unit: str = ""
    obstacles: list[dict[str, Any]] = field(default_factory=list)
    frames: int = 0
    frames_per_second: int = FRAMES_PER_SECOND


def main(
    folder: Path,
    out: Path,
    field: str = "J",
    seconds: float = 4.0,
    report: Callable[[int, int], None] | None = None,
    opacity: float = 1.0,
    view: ViewOptions | None = None,
) -> Path:
    """Draw a movie of a run and return its path.

    Between the stored loads displacement and colours are interpolated by monotone cubic
    polynomials (PCHIP); each stored state appears as it is.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path
        The movie: a file .mp4 or .gif.
    field : str
        The field that the colours show, as for `fem_snh.viewing.render.main`.
    seconds : float
        Length of the movie [s].
    report : callable, optional
        Called with the numbers of frames drawn and of all frames.
    opacity : float
        Opacity of the body, as for `fem_snh.viewing.render.main`.
    view : ViewOptions, optional
        Clip plane, camera and hidden parts.

    Raises
    ------
    BadInput
        For another file type, if a package is missing, if fewer than two states are stored, or as
        `fem_snh.viewing.render.main`.
    """
    out = output_path("--movie", out)
    if out.suffix.lower() not in TYPES:
        raise bad_value("--movie", str(out), f"a file {' or '.join(TYPES)}")
    if not MIN_SECONDS <= seconds <= MAX_SECONDS:
        raise bad_value("--seconds", seconds, f"a number from {MIN_SECONDS:g} to {MAX_SECONDS:g}")
    require("render", ("pyvista", "matplotlib"))
    remedy = "'fem_snh[movies]', or write a .gif"
    require(f"a movie {out.suffix}", TYPES[out.suffix.lower()], remedy)
    run = StoredRun(folder, field, view)
    if len(run.states) < 2:
        raise BadInput(f"{folder}: a movie needs two stored loads or more: found {len(run.states)}")
    frames = max(2, round(seconds * FRAMES_PER_SECOND))
    job = MovieJob(
        field,
        title(run.record),
        [Panel(files, "", load) for load, files in run.states.items()],
        str(out),
        check_opacity(opacity),
        view=run.view,
        units=Units.of(run.record),
        names=[parameter(run.record, load) for load in run.states],
        load_name=load_name(run.record),
        load_unit=load_unit(run.record),
        obstacles=obstacle_poses(run.record, run.folder, hide=run.view.hide),
        frames=frames,
    )

    def show(line: str) -> None:
        if report and line.isdigit():
            report(int(line), frames)

    draw_elsewhere(asdict(job), "fem_snh.viewing.render.frames", show, frames * _FRAME_TIMEOUT)
    return out
