"""Draw the body of a run's folder, coloured by J or another field: pictures, movies, a page.

The drawing functions, in `fem_snh.viewing.render.drawing` and `fem_snh.viewing.page`, are called in
a process of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fem_snh.errors import BadInput, bad_value
from fem_snh.files import output_path
from fem_snh.records.output_fields import ERRORS
from fem_snh.records.units import Units
from fem_snh.viewing import require, run_elsewhere
from fem_snh.viewing.stored_run import (
    DOT,
    WHOLE,
    Panel,
    StoredRun,
    ViewOptions,
    choose_loads,
    common_units,
    material_name,
    read_record,
    stored_loads,
    title,
)

#: Types of pictures.
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
#: Modes of a frequency below this fraction of the highest are rigid, drawn on request only.
_RIGID = 1e-3
#: Number of modes drawn by default.
_SHOWN = 6
#: File types of movies, and the packages that each needs beside Pillow.
MOVIES: dict[str, tuple[str, ...]] = {".mp4": ("imageio", "imageio_ffmpeg"), ".gif": ()}
FRAMES_PER_SECOND = 25
#: Bounds of a movie's length [s]; the upper one is 15,000 frames.
MIN_SECONDS, MAX_SECONDS = 0.1, 600.0
#: Upper bound of the time that a frame takes to draw [s], after which the process counts as hung.
_FRAME_TIMEOUT = 60.0
#: States on a page, at most: each takes about a tenth of a second and 100 kB for 1,000 cells.
MAX_STATES = 13


@dataclass(frozen=True)
class Job:
    """The input of a drawing process.

    ``panels`` are the states to draw, and ``out`` is the file to write. Labels are in ``units``;
    None: in SI units, and without a scale bar. BadInput unless ``opacity`` is in (0, 1].
    """

    field: str
    title: str
    panels: list[Panel]
    out: Path
    opacity: float = 1.0
    view: ViewOptions = WHOLE
    units: Units | None = None

    def __post_init__(self) -> None:
        if not 0 < self.opacity <= 1:
            raise bad_value("--opacity", self.opacity, "a number above 0, up to 1")


def main(
    folder: Path,
    out: Path | None = None,
    loads: Sequence[float] | None = None,
    field: str = "J",
    modes: bool = False,
    opacity: float = 1.0,
    view: ViewOptions | None = None,
    report: Callable[[str], None] | None = None,
) -> Path:
    """Draw the body of a run at some loads or times side by side and return the picture's path.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path, optional
        Default: ``folder/<field>.png``.
    loads : sequence of float, optional
        Stored loads from 0 to 1, or times [s] of a dynamic run; default: all load steps if there
        are at most four, else those at 1/3, 2/3, 1; only the last if the field is the error of a
        goal.
    field : str
        A field that the run has written, or a component such as ``cauchy_stress.xy``. A whole
        vector or tensor is drawn by its magnitude (the Frobenius norm of a tensor).
    modes : bool
        Draw eigenmodes instead (`draw_modes`); ``loads`` are their numbers.
    opacity : float
        Opacity of the body, between 0 and 1: bones are seen through a translucent one.
    view : ViewOptions, optional
        Clip plane, camera, hidden parts and the range of the colours.
    report : callable, optional
        Called with a line that has the smallest and the largest value of the field, and where they
        are in the body at rest; not for modes.

    Raises
    ------
    BadInput
        If files are missing or cannot be read, a load was not stored, or OpenGL is missing.
    """
    folder = Path(folder)
    if modes:
        for option, given in (("--hide", view and view.hide), ("--range", view and view.limits)):
            if given:
                raise BadInput(f"--modes and {option}: expected one of the two")
        return draw_modes(folder, out, loads, view)
    run = StoredRun(folder, field, view)
    out = picture_path(out) if out is not None else folder / f"{field}.png"
    if not loads and field.startswith(ERRORS):
        loads = [max(run.states)]
    panels = [run.panel(load) for load in choose_loads(list(run.states), loads)]
    units = Units.of(run.record)
    draw(Job(field, title(run.record), panels, out, opacity, run.view, units), report)
    return out


def draw_modes(
    folder: Path,
    out: Path | None = None,
    numbers: Sequence[float] | None = None,
    view: ViewOptions | None = None,
) -> Path:
    """Draw eigenmodes of a run and return the path of the picture.

    The outline shows the state of linearisation; all modes are exaggerated to the same amplitude.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path, optional
        Default: ``folder/modes.png``.
    numbers : sequence of float, optional
        Numbers of the modes, from 1; default: the first six that deform the body.
    view : ViewOptions, optional
        Clip plane and camera.

    Raises
    ------
    BadInput
        If the run has no modes or no mode of a number, or OpenGL or a package is missing.
    """
    folder = Path(folder)
    record = read_record(folder)
    try:
        frequencies = [float(f) for f in record["modes"]["frequencies"]]
    except KeyError:
        raise BadInput(
            f"{folder / 'run.json'}: this run has no modes: its scene needs a table [modes]"
        ) from None
    stored = stored_loads(folder / "modes.pvd")
    out = picture_path(out) if out is not None else folder / "modes.png"
    panels = []
    for number in choose_modes(frequencies, numbers):
        if number not in stored:
            raise BadInput(f"{folder / 'modes.pvd'}: holds no mode {number}")
        panels.append(Panel(stored[number], mode_label(number, frequencies[number - 1])))
    units = Units.of(record)
    draw(Job("mode", title(record), panels, out, view=view or WHOLE, units=units))
    return out


def choose_modes(frequencies: list[float], wanted: Sequence[float] | None) -> list[int]:
    """Return the numbers of the modes to draw, from 1; default: the first six that are not rigid.

    BadInput if the run has no such mode.
    """
    count = len(frequencies)
    if wanted:
        for number in wanted:
            if number not in range(1, count + 1):
                raise BadInput(f"no mode {number:g}: the run has 1 to {count}")
        return [int(number) for number in wanted]
    highest = max(abs(f) for f in frequencies)
    shown = [i for i, f in enumerate(frequencies, 1) if abs(f) > _RIGID * highest]
    return (shown or list(range(1, count + 1)))[:_SHOWN]


def mode_label(number: int, frequency: float) -> str:
    """Return ``mode 3  ·  1.28 Hz``; a negative frequency stands for an imaginary one."""
    text = f"mode {number}  ·  {abs(frequency):.4g} Hz"
    return text if frequency >= 0 else text.replace("Hz", "i Hz, unstable")


def compare(
    folders: Sequence[Path],
    out: Path,
    load: float | Sequence[float] | None = None,
    labels: Sequence[str] | None = None,
    field: str = "J",
) -> Path:
    """Draw the bodies of runs side by side with one scale and colour map; return the path.

    Parameters
    ----------
    folders : sequence of Path
        Folders of the runs, one panel each.
    out : Path
        The picture.
    load : float or sequence of float, optional
        The load or time of all runs, or one for each; default: the last that each run has stored.
    labels : sequence of str, optional
        Labels of the panels, before load and volume; default: the names of the materials. Parts
        that all labels share move to the title.
    field : str
        As for `main`.

    Raises
    ------
    BadInput
        As from `main`.
    """
    out = picture_path(out)
    runs = [StoredRun(folder, field) for folder in folders]
    if not runs:
        raise BadInput("nothing to draw: give folders of runs")
    names = labels or [material_name(run.record) for run in runs]
    loads = load if isinstance(load, Sequence) else [load] * len(folders)
    panels = []
    for run, name, at in zip(runs, names, loads, strict=True):
        stored = list(run.states)
        panel = run.panel(*choose_loads(stored, [stored[-1] if at is None else at]))
        panels.append(replace(panel, label=f"{name}{DOT}{panel.label}"))
    common = _common([title(run.record) for run in runs])
    if len(panels) > 1:
        shared = _common([panel.label for panel in panels])
        for index, panel in enumerate(panels):
            own = [part for part in panel.label.split(DOT) if part not in shared]
            panels[index] = replace(panel, label=DOT.join(own))
        common += [part for part in shared if part not in common]
    units = common_units([run.record for run in runs])
    draw(Job(field, DOT.join(common), panels, out, units=units))
    return out


def _common(texts: Sequence[str]) -> list[str]:
    """Return the parts, separated by `DOT`, that all texts have."""
    parts = [text.split(DOT) for text in texts]
    return [part for part in parts[0] if all(part in other for other in parts)]


def movie(
    folder: Path,
    out: Path,
    field: str = "J",
    seconds: float = 4.0,
    report: Callable[[int, int], None] | None = None,
    opacity: float = 1.0,
    view: ViewOptions | None = None,
) -> Path:
    """Draw a movie of a run and return its path.

    Between the stored loads, displacement and field are interpolated by monotone cubic polynomials
    (PCHIP).

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path
        The movie: a file .mp4 or .gif.
    field : str
        The field that the colours show, as for `main`.
    seconds : float
        Length of the movie [s].
    report : callable, optional
        Called with the number of frames drawn and the number of all frames.
    opacity : float
        Opacity of the body, as for `main`.
    view : ViewOptions, optional
        Clip plane, camera and hidden parts.

    Raises
    ------
    BadInput
        For another file type, if a package is missing, if fewer than two states are stored, or as
        from `main`.
    """
    out = output_path("--movie", out)
    if out.suffix.lower() not in MOVIES:
        raise bad_value("--movie", str(out), f"a file {' or '.join(MOVIES)}")
    if not MIN_SECONDS <= seconds <= MAX_SECONDS:
        raise bad_value("--seconds", seconds, f"a number from {MIN_SECONDS:g} to {MAX_SECONDS:g}")
    require("render", ("pyvista", "matplotlib"))
    remedy = "'fem_snh[movies]', or write a .gif"
    require(f"a movie {out.suffix}", MOVIES[out.suffix.lower()], remedy)
    run = StoredRun(folder, field, view)
    if len(run.states) < 2:
        raise BadInput(f"{folder}: a movie needs two stored loads or more: found {len(run.states)}")
    frames = max(2, round(seconds * FRAMES_PER_SECOND))
    panels, units = [run.panel(load) for load in run.states], Units.of(run.record)
    job = Job(field, title(run.record), panels, out, opacity, run.view, units)
    timeout, writer = frames * _FRAME_TIMEOUT, f"{__name__}.drawing:write_movie"
    run_elsewhere(writer, job, run.record, frames, report=report, timeout=timeout, opengl=True)
    return out


def page(
    folder: Path,
    out: Path | None = None,
    field: str = "J",
    view: ViewOptions | None = None,
) -> Path:
    """Write a run as one HTML page and return its path.

    The page needs no other file and no network: it holds the viewer (trame's vtk.js) and a vtk.js
    scene for each of at most `MAX_STATES` states.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path, optional
        The page; default: ``folder/view.html``.
    field : str
        The field that the colours show, as for `main`.
    view : ViewOptions, optional
        Clip plane, hidden parts, and the camera of the page's first view.

    Raises
    ------
    BadInput
        If a package or a file is missing, a file cannot be read, or the page cannot be written.
    """
    out = output_path("--out", out) if out is not None else Path(folder) / "view.html"
    if out.suffix not in (".html", ".htm"):
        raise BadInput(f"--out {out}: expected a file .html")
    require("view", ("pyvista", "matplotlib"))
    require("view", ("trame_vtk",), "'fem_snh[view]'")
    run = StoredRun(folder, field, view)
    states = [run.panel(load) for load in choose_states(list(run.states))]
    job = Job(field, "", states, out, view=run.view, units=Units.of(run.record))
    run_elsewhere("fem_snh.viewing.page:write_page", job, run.record, opengl=True)
    return out


def choose_states(loads: list[float]) -> list[float]:
    """Return at most `MAX_STATES` of the loads, evenly chosen, with the first and the last."""
    if len(loads) <= MAX_STATES:
        return loads
    last, intervals = len(loads) - 1, MAX_STATES - 1
    return [loads[round(k * last / intervals)] for k in range(MAX_STATES)]


def picture_path(out: str | Path) -> Path:
    """Return the path of a picture; raise BadInput unless it is a file of `PICTURES`."""
    out = output_path("--out", out)
    if out.suffix.lower() not in PICTURES:
        raise bad_value("--out", str(out), f"a file {', '.join(PICTURES)}")
    return out


def draw(job: Job, report: Callable[[str], None] | None = None) -> None:
    """Draw a job in a separate process, as `drawing.draw`; raise BadInput if this fails."""
    require("render", ("pyvista", "matplotlib"))
    run_elsewhere(f"{__name__}.drawing:draw", job, report=report, opengl=True)
