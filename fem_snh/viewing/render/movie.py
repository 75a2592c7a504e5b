"""A movie of the deforming body, smooth over the load, from the states that a run has stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fem_snh.atomic_files import output_path
from fem_snh.errors import BadInput, bad_value
from fem_snh.viewing.render import (
    Panel,
    check_opacity,
    panel_label,
    read_record,
    series,
    stored_loads,
    title,
)
from fem_snh.viewing.render.fields import check_field
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
class MovieJob:
    """The input of the drawing process `fem_snh.viewing.render.frames`."""

    field: str
    title: str
    states: list[Panel]
    obstacles: list[dict[str, Any]]
    loads: list[float]
    names: list[float]
    load_name: str
    load_unit: str
    frames: int
    frames_per_second: int
    out: str
    opacity: float


def main(
    folder: Path,
    out: Path,
    field: str = "J",
    seconds: float = 4.0,
    report: Callable[[int, int], None] | None = None,
    opacity: float = 1.0,
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

    Raises
    ------
    BadInput
        For another file type, if a package is missing, if fewer than two states are stored, or as
        `fem_snh.viewing.render.main`.
    """
    folder, out = Path(folder), output_path("--movie", out)
    if out.suffix.lower() not in TYPES:
        raise bad_value("--movie", str(out), f"a file {' or '.join(TYPES)}")
    if not MIN_SECONDS <= seconds <= MAX_SECONDS:
        raise bad_value("--seconds", seconds, f"a number from {MIN_SECONDS:g} to {MAX_SECONDS:g}")
    require("render", ("pyvista", "matplotlib"))
    remedy = "'fem_snh[movies]', or write a .gif"
    require(f"a movie {out.suffix}", TYPES[out.suffix.lower()], remedy)
    record = read_record(folder)
    stored = dict(sorted(stored_loads(series(folder)).items()))
    check_field(series(folder), field)
    if len(stored) < 2:
        raise BadInput(f"{folder}: a movie needs two stored loads or more: found {len(stored)}")
    frames = max(2, round(seconds * FRAMES_PER_SECOND))
    job = MovieJob(
        field,
        title(record),
        [Panel([str(f) for f in files], panel_label(record, t)) for t, files in stored.items()],
        obstacle_poses(record, folder),
        list(stored),
        [parameter(record, t) for t in stored],
        load_name(record),
        load_unit(record),
        frames,
        FRAMES_PER_SECOND,
        str(out),
        check_opacity(opacity),
    )

    def show(line: str) -> None:
        if report and line.isdigit():
            report(int(line), frames)

    timeout = frames * _FRAME_TIMEOUT
    draw_elsewhere(asdict(job), "fem_snh.viewing.render.frames", show, timeout)
    return out
