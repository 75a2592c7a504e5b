"""Draw the deformed body from a run folder, coloured by J or another field.

`fem_snh.viewing.render.drawing` draws in a process of its own: see `fem_snh.viewing.worker`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput, bad_value
from fem_snh.files import output_path
from fem_snh.records.output_fields import ERRORS
from fem_snh.records.run_record import load_record
from fem_snh.records.units import Units, volume_change
from fem_snh.viewing.render.options import WHOLE, ViewOptions
from fem_snh.viewing.render.records import (
    check_field,
    check_hidden,
    common_units,
    hidden_cells,
    load_name,
    load_unit,
    material_name,
    obstacle_poses,
    parameter,
    poisson_ratio,
    step_at,
    stored_loads,
)
from fem_snh.viewing.worker import require, run_elsewhere

#: The module that draws.
_DRAWING = "fem_snh.viewing.render.drawing"
#: Types of pictures.
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")

#: Frequencies below this fraction of the highest are rigid motions, drawn on request only.
_RIGID = 1e-3
_SHOWN = 6
#: File types, and the packages that write them beside matplotlib's Pillow.
MOVIES: dict[str, tuple[str, ...]] = {".mp4": ("imageio", "imageio_ffmpeg"), ".gif": ()}
FRAMES_PER_SECOND = 25
#: Bounds of a movie's length [s]; the upper one is 15,000 frames.
MIN_SECONDS, MAX_SECONDS = 0.1, 600.0
#: Upper bound of the time that a frame takes to draw [s], after which the process counts as hung.
_FRAME_TIMEOUT = 60.0
#: What separates the parts of a label.
_DOT = "  ·  "


@dataclass(frozen=True)
class Panel:
    """One panel: the files that hold its fields, its label, its load and the run's obstacles."""

    files: list[str]
    label: str
    load: float = 0.0
    obstacles: list[dict[str, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class Job:
    """The input of a drawing process; ``out`` is the file.

    With ``revolve`` sections are drawn as bodies of revolution. ``note`` follows the label of the
    colour bar. ``units`` are those of labels; None: SI, and no scale bar.
    """

    field: str
    title: str
    panels: list[Panel]
    out: str
    opacity: float = 1.0
    revolve: bool = False
    view: ViewOptions = WHOLE
    note: str = ""
    units: Units | None = None


@dataclass(frozen=True)
class MovieJob(Job):
    """The input of the process that draws a movie.

    The panels are the stored states; ``names`` are the values of the load parameter there, and
    ``obstacles`` those of the run at all its loads.
    """

    names: list[float] = field(default_factory=list)
    load_name: str = ""
    load_unit: str = ""
    obstacles: list[dict[str, Any]] = field(default_factory=list)
    frames: int = 0


def main(
    folder: Path,
    out: Path | None = None,
    loads: Sequence[float] | None = None,
    field: str = "J",
    modes: bool = False,
    opacity: float = 1.0,
    revolve: bool = False,
    view: ViewOptions | None = None,
    report: Callable[[str], None] | None = None,
) -> Path:
    """Draw the body of a run at some loads or times side by side and return the path of the PNG.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path, optional
        Default: ``folder/<field>.png``.
    loads : sequence of float, optional
        In 0..1, or times [s] of a run in time; default: all load steps if there are at most four,
        else those at 1/3, 2/3, 1; of the error of a goal, the last.
    field : str
        A field that the run has written, or a component such as ``cauchy_stress.xy``. A whole
        vector or tensor is drawn by its magnitude (the Frobenius norm of a tensor).
    modes : bool
        Draw eigenmodes instead (`draw_modes`); ``loads`` are their numbers.
    opacity : float
        Opacity of the body, between 0 and 1: bones are seen through a translucent one.
    revolve : bool
        Draw an axisymmetric body revolved, with a quarter left open, in place of its section.
    view : ViewOptions, optional
        Clip plane, camera, hidden parts and the range of the colours.
    report : callable, optional
        Called with a line that has the smallest and the largest value of the field, and where they
        are in the body at rest; not for modes.

    Raises
    ------
    BadInput
        If files are missing or cannot be read, a load was not stored, or nothing can draw here.
    """
    folder = Path(folder)
    if modes:
        for option, given in (
            ("--revolve", revolve),
            ("--hide", view and view.hide),
            ("--range", view and view.limits),
        ):
            if given:
                raise BadInput(f"--modes and {option}: expected one of the two")
        return draw_modes(folder, out, loads, view)
    run = StoredRun(folder, field, view)
    out = picture_path(out) if out is not None else folder / f"{field}.png"
    run.check_revolved(revolve)
    if not loads and field.startswith(ERRORS):
        loads = [max(run.states)]
    chosen = choose_loads(list(run.states), loads)
    panels, note = [run.panel(load) for load in chosen], run.note(chosen)
    opacity = check_opacity(opacity)
    units = Units.of(run.record)
    job = Job(field, title(run.record), panels, str(out), opacity, revolve, run.view, note, units)
    draw(job, report)
    return out


def draw_modes(
    folder: Path,
    out: Path | None = None,
    numbers: Sequence[float] | None = None,
    view: ViewOptions | None = None,
) -> Path:
    """Draw eigenmodes of a run and return the path of the PNG.

    The outline shows the linearised state; all modes are exaggerated to the same amplitude.

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
        If the run has no modes or no such number, or nothing can draw here.
    """
    folder = Path(folder)
    record = read_record(folder)
    frequencies = read_frequencies(folder, record)
    stored = stored_loads(folder / "modes.pvd")
    out = picture_path(out) if out is not None else folder / "modes.png"
    panels = []
    for number in choose_modes(frequencies, numbers):
        if number not in stored:
            raise BadInput(f"{folder / 'modes.pvd'}: holds no mode {number}")
        files = [str(file) for file in stored[number]]
        panels.append(Panel(files, mode_label(number, frequencies[number - 1])))
    shown, units = view or WHOLE, Units.of(record)
    draw(Job("mode", title(record), panels, str(out), view=shown, units=units))
    return out


def read_frequencies(folder: Path, record: dict[str, Any]) -> list[float]:
    """Return the eigenfrequencies [Hz] of a run's record; raise BadInput if it has none."""
    try:
        return [float(f) for f in record["modes"]["frequencies"]]
    except (KeyError, TypeError, ValueError):
        raise BadInput(
            f"{folder / 'run.json'}: this run has no modes: its scene needs a table [modes]"
        ) from None


def choose_modes(frequencies: list[float], wanted: Sequence[float] | None) -> list[int]:
    """Return the numbers of the modes to draw."""
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
    """Return ``mode 3  ·  1.28 Hz``; a negative frequency marks an unstable mode."""
    text = f"mode {number}  ·  {abs(frequency):.4g} Hz"
    return text if frequency >= 0 else text.replace("Hz", "i Hz, unstable")


def compare(
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
        panels.append(replace(panel, label=f"{name}{_DOT}{panel.label}"))
    common = _common([title(run.record) for run in runs])
    if len(panels) > 1:
        shared = _common([panel.label for panel in panels])
        for index, panel in enumerate(panels):
            own = [part for part in panel.label.split(_DOT) if part not in shared]
            panels[index] = replace(panel, label=_DOT.join(own))
        common += [part for part in shared if part not in common]
    units = common_units([run.record for run in runs])
    draw(Job(field, _DOT.join(common), panels, str(out), units=units))
    return out


def _common(texts: Sequence[str]) -> list[str]:
    """Return the parts that all texts have."""
    parts = [text.split(_DOT) for text in texts]
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

    Between the stored loads displacement and colours are interpolated by monotone cubic
    polynomials (PCHIP); each stored state appears as it is.

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
        Called with the numbers of frames drawn and of all frames.
    opacity : float
        Opacity of the body, as for `main`.
    view : ViewOptions, optional
        Clip plane, camera and hidden parts.

    Raises
    ------
    BadInput
        For another file type, if a package is missing, if fewer than two states are stored, or as
        `main`.
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

    timeout = frames * _FRAME_TIMEOUT
    run_elsewhere(_DRAWING, "write_movie", job, report=show, timeout=timeout, opengl=True)
    return out


def picture_path(out: str | Path) -> Path:
    """Return the path of a picture; raise BadInput unless it is a file of `PICTURES`."""
    out = output_path("--out", out)
    if out.suffix.lower() not in PICTURES:
        raise bad_value("--out", str(out), f"a file {', '.join(PICTURES)}")
    return out


def check_opacity(opacity: float) -> float:
    """Return the opacity; raise BadInput unless it is between 0 and 1."""
    if not 0 < opacity <= 1:
        raise bad_value("--opacity", opacity, "a number above 0, up to 1")
    return opacity


class StoredRun:
    """The folder of a run.

    Parameters
    ----------
    folder : Path
        The folder.
    field : str, optional
        A field, or a component of one, that the run must have written.
    view : ViewOptions, optional
        What is shown.

    Attributes
    ----------
    record : dict
        Its run.json.
    pvd : Path
        The collection of its states: of the skin if a lattice carries one.
    states : dict
        {load or time: .vtu files of a stored state}, ascending.

    Raises
    ------
    BadInput
        If a file is missing or cannot be read, or the run has not written the field or has no
        part of a name that is to be hidden.
    """

    def __init__(
        self, folder: Path, field: str | None = None, view: ViewOptions | None = None
    ) -> None:
        self.folder, self._field = Path(folder), field
        self.record = read_record(self.folder)
        hide = view.hide if view else ()
        check_hidden(self.record, hide)
        self.view = replace(view or WHOLE, hidden_cells=hidden_cells(self.record, hide))
        skin = self.folder / "skin.pvd"
        self.pvd = skin if skin.is_file() else self.folder / "fields.pvd"
        self.states = {
            load: [str(file) for file in files]
            for load, files in sorted(stored_loads(self.pvd).items())
        }
        if field is not None:
            check_field(self.pvd, field)

    def check_revolved(self, revolve: bool) -> None:
        """Raise BadInput for a body that is to be drawn revolved and is no body of revolution."""
        kinematics = self.record.get("kinematics")
        if revolve and not str(kinematics).startswith("axisymmetric"):
            raise BadInput(f"--revolve: expected an axisymmetric run; kinematics = {kinematics!r}")
        if revolve and self.view.clip:
            raise BadInput("--clip and --revolve: expected one of the two")

    def panel(self, load: float) -> Panel:
        """Return the panel of a stored load or time."""
        obstacles = obstacle_poses(self.record, self.folder, load, self.view.hide)
        return Panel(self.states[load], panel_label(self.record, load), load, obstacles)

    def note(self, loads: Sequence[float]) -> str:
        """Return what the colours of some loads hide: the smallest J at a point, as cells
        have means."""
        steps = [step_at(self.record, load) for load in loads]
        smallest = [step["min_J"] for step in steps if step and step.get("min_J") is not None]
        if self._field != "J" or not smallest:
            return ""
        return f"smallest at a quadrature point {min(smallest):.3g}"


def read_record(folder: Path) -> dict[str, Any]:
    """Return ``folder/run.json``; raise BadInput if it is missing or no record of a run."""
    path = folder / "run.json"
    if not path.exists():
        raise BadInput(f"{folder}: no run.json here: give the folder of a run (--out DIR)")
    return load_record(path)


def choose_loads(stored: list[float], wanted: Sequence[float] | None) -> list[float]:
    """Return the stored loads to draw; raise BadInput if a requested one was not stored."""
    if wanted:
        same = 1e-6 * max(map(abs, stored))
        for load in wanted:
            if not any(math.isclose(load, s, abs_tol=same) for s in stored):
                raise BadInput(f"no fields at load {load:g}: stored are {_listed(stored)}")
        return [min(stored, key=lambda s: abs(s - load)) for load in wanted]
    steps = [s for s in stored if s > 0] or stored
    if len(steps) <= 4:
        return steps
    return [steps[round(i * len(steps) / 3) - 1] for i in (1, 2, 3)]


def _listed(loads: list[float]) -> str:
    return ", ".join(f"{load:g}" for load in loads)


def title(record: dict[str, Any]) -> str:
    """Return scene, material, nu, element and number of cells in one line."""
    ratio = f"ν = {poisson_ratio(record)}"
    parts = [str(record["scene"]), material_name(record), ratio]
    if "cells" in record and "element" in record:
        parts.append(f"{record['cells']:,} {record['element']} cells".replace(",", "\u2009"))
    return "  ·  ".join(parts)


def panel_label(record: dict[str, Any], load: float) -> str:
    """Return name and value of the load or time, and volume change and smallest J of its step."""
    value = parameter(record, load)
    label = f"{load_name(record)} {number(value) if not load_unit(record) else f'{value:.3g}'}"
    label += load_unit(record)
    step = step_at(record, load)
    if step is None:
        return label
    if step.get("volume_ratio") is not None:
        change = volume_change(step["volume_ratio"]).replace("-", "\u2212")
        label += f"  ·  volume {change} %"
    if step.get("min_J") is not None:
        label += f"  ·  min J {step['min_J']:.2f}".replace("-", "\u2212")
    return label if step.get("converged", True) else label + "  ·  not converged"


def number(x: float) -> str:
    """Return ``x`` as text: a simple fraction of pi, or three digits."""
    turn = Fraction(x / math.pi).limit_denominator(12)
    if turn == 0 or not math.isclose(x, turn * math.pi, rel_tol=1e-9):
        return f"{x:.3g}"
    top = {1: "π", -1: "-π"}.get(turn.numerator, f"{turn.numerator}π")
    return top if turn.denominator == 1 else f"{top}/{turn.denominator}"


def draw(job: Job, report: Callable[[str], None] | None = None) -> None:
    """Draw in a separate process and report what it prints; raise BadInput if it cannot."""
    require("render", ("pyvista", "matplotlib"))
    run_elsewhere(_DRAWING, "draw", job, report=report, opengl=True)
