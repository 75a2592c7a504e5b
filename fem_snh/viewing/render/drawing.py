"""Draw panels with PyVista and arrange them with matplotlib, as a picture or a movie.

`draw` and `write_movie` are called in a process of their own: `fem_snh.viewing.run_elsewhere`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import floor, log10
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from PIL import Image

from fem_snh.errors import BadInput
from fem_snh.files import make_folder_of, replacement, write_file
from fem_snh.records.run_record import Record
from fem_snh.viewing import ignore
from fem_snh.viewing.render import FRAMES_PER_SECOND, Job
from fem_snh.viewing.render.surfaces import DrawnBody, Obstacles, body, body_of, is_flat
from fem_snh.viewing.states import InterpolatedStates
from fem_snh.viewing.stored_run import (
    DOT,
    TOWARDS,
    WHOLE,
    ViewOptions,
    is_nonnegative,
    label,
    load_name,
    load_unit,
    parameter,
)

#: Width of the picture [pixels].
WIDTH = 1600
#: Heights of the title, of a panel's label and of the colour bar [pixels].
TOP, LABEL, FOOT = 90, 50, 130
#: Size of the labels [points], and the mean width of a character of this size [pixels] (measured).
LABEL_SIZE, CHARACTER = 8.5, 12.5
#: Length of the scale bar, relative to the width of a panel, before it is rounded up.
_SCALE_BAR = 0.1
#: Largest height of a panel [pixels].
TALLEST = 1200
#: Pixels per inch, which relate sizes of fonts to pixels.
DPI = 200
#: Directions towards the viewer of a body that is long in x or in y, seen from its side.
TOWARDS_LONG = ((0.32, -1.0, 0.15), (1.0, 0.32, 0.15))
#: Colour and opacity of obstacles, bones and rigid shapes; a translucent body shows its bones.
_STYLES = {"obstacles": ("#a0a0a0", 0.35), **dict.fromkeys(("bones", "rigid"), ("#e3d9bf", 1.0))}
#: Position (right, up) and intensity of the key light and the fill light at the camera.
LIGHTS = ((-0.6, 0.8, 0.4), (0.5, 0.1, 0.3))
#: A section has the colours of the bar, which no light changes.
_UNLIT: dict[str, Any] = {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}
#: A value outside of the colours' range by less than this fraction of the range is rounding.
_ROUNDING = 1e-9
#: Colour bars of a smaller range, relative to their values, have fewer ticks: numbers of six digits
#: and more.
_LONG_NUMBERS = 1e-3
#: Pixels: the width of a frame, and the largest height of the body in it.
_FRAME_WIDTH, _FRAME_TALLEST = 1280, 720
#: Colours of the palette of a frame of a GIF.
_GIF_COLOURS = 256


def colours(
    field: str, values: np.ndarray, limits: Sequence[float] | None = None
) -> tuple[str, Normalize, str]:
    """Return colour map, range and open ends (matplotlib's ``extend``) of the shared colour bar.

    The range excludes the lowest and highest percent of the values, or is given by ``limits``. J is
    centred at 1, so that grey means no change of volume; other fields that change sign are centred
    at 0. The range of a field that cannot be negative starts at 0. BadInput if no value is finite.
    """
    values = values[np.isfinite(values)]
    if not len(values):
        raise BadInput(f"'{field}' has no finite value")
    low, high = np.percentile(values, [1, 99])
    if field == "mode":
        return "viridis", Normalize(0, 1), "neither"
    one_sided = is_nonnegative(field)
    signed = not one_sided and low < 0 < high
    volume_ratio = field in ("J", "min_J")
    centre = 1.0 if volume_ratio else 0.0 if signed else None
    if centre is not None:
        half = round_up(max(high - centre, centre - low, 1e-3))
        half = min(half, 1.0) if volume_ratio else half  # cells with J < 0 are inverted
        low, high = centre - half, centre + half
    elif one_sided and high > 0:
        low = 0.0
    elif high <= low:
        high = low + max(abs(low), 1.0) * 1e-3
    if limits:
        low, high = limits
        centre = centre if centre == (low + high) / 2 else None
    rounding = _ROUNDING * (high - low)
    under, over = values.min() < low - rounding, values.max() > high + rounding
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[under, over]
    return ("coolwarm" if centre is not None else "viridis"), Normalize(low, high), extend


def round_up(x: float) -> float:
    """Return ``x`` > 0 rounded up to 1, 1.5, 2, 3, 4, 5, 6, 8 or 10 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(x))
    return next(m for m in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if m * power >= x * (1 - 1e-9)) * power


@dataclass
class View:
    """A parallel projection for all panels; lengths are those of the model.

    ``towards`` (the viewer) and ``up`` are unit vectors.
    """

    centre: np.ndarray
    towards: np.ndarray
    up: np.ndarray
    width: float
    height: float

    def place(self, camera: Any, distance: float) -> None:
        """Place a camera of PyVista at a distance from the centre."""
        camera.focal_point = self.centre
        camera.position = self.centre + distance * self.towards
        camera.up = self.up


def view(
    bodies: Sequence[DrawnBody],
    solids: Sequence[pv.PolyData] = (),
    options: ViewOptions = WHOLE,
) -> View:
    """Return a view from the front, right and above, or from the side of a long body.

    A body in the plane is seen along z. Otherwise z is upwards, or y if the camera looks along z.
    ``solids`` are the surfaces in all panels; they are in the view, too. The ``options`` may choose
    direction, centre and magnification.
    """
    points = np.concatenate([np.concatenate([b.surface.points, b.ghost.points]) for b in bodies])
    size = np.ptp(points, axis=0)
    points = np.concatenate([points, *(solid.points for solid in solids)])
    towards = np.array(TOWARDS)
    if size.max() > 2 * np.median(size) and size.argmax() != 2:
        towards = np.array(TOWARDS_LONG[size.argmax()])
    if all(is_flat(b.rest.points) for b in bodies):
        towards = np.array([0.0, 0.0, 1.0])
    if options.camera:
        towards = np.array(options.camera)
    towards /= np.linalg.norm(towards)
    upwards = [0.0, 0.0, 1.0] if abs(towards[2]) < 1 - 1e-9 else [0.0, 1.0, 0.0]
    right = np.cross(upwards, towards)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(towards, right), towards])
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    width, height = (high - low)[:2] * 1.04
    centre = (low + high) / 2 @ axes
    if options.focus:
        centre = np.array(options.focus)
    return View(centre, towards, axes[1], width / options.zoom, height / options.zoom)


class Drawing:
    """What all panels, frames or states of one picture share: colours, view and solids.

    `colours` returns the attributes ``cmap``, ``norm`` and ``extend``; ``solids`` has the result of
    `Obstacles.at` for each panel.

    Parameters
    ----------
    job : Job
        What is drawn.
    bodies : sequence of DrawnBody, optional
        The bodies, one for each panel or state; default: those of the panels' files.
    """

    def __init__(self, job: Job, bodies: Sequence[DrawnBody] | None = None) -> None:
        if bodies is None:
            bodies = [body(panel.files, job.field, job.view) for panel in job.panels]
        self.job, self.bodies = job, bodies
        values = np.concatenate([body.values for body in bodies])
        self.cmap, self.norm, self.extend = colours(job.field, values, job.view.limits)
        found = [value for body in bodies for value, _ in body.extremes]
        low, high = min(found, default=np.nan), max(found, default=np.nan)
        #: The smallest and the largest value, also inside of the bodies; rounding to 0 is removed.
        self.extremes = (0.0 if abs(low) < _ROUNDING * abs(high) else low), high
        points = np.concatenate([p for b in bodies for p in (b.surface.points, b.ghost.points)])
        limits = np.array([points.min(axis=0), points.max(axis=0)])
        self._flat = all(is_flat(b.rest.points) for b in bodies)
        solids = [Obstacles(panel.obstacles, self._flat) for panel in job.panels]
        self.solids_at = lambda panel, load: solids[panel].at(load, limits)
        self.solids = [self.solids_at(k, panel.load) for k, panel in enumerate(job.panels)]
        shown = [solid for panel in self.solids for _, solid in panel]
        self.view = view(bodies, shown, job.view)

    def add(
        self,
        plotter: Any,
        item: DrawnBody,
        edges: dict[str, Any],
        ghost: float,
        shift: Sequence[float] = (0.0, 0.0, 0.0),
        **options: Any,
    ) -> None:
        """Add a body, its element edges and its outline at rest to a plotter.

        The outline has the line width ``ghost``. The element edges have the options ``edges`` and
        are moved by ``shift``; the surface has the ``options``.
        """
        limits = (self.norm.vmin, self.norm.vmax)
        if is_flat(item.surface.points):
            options |= _UNLIT
        plotter.add_mesh(
            item.surface, scalars=self.job.field, cmap=self.cmap, clim=limits, **options
        )
        if item.edges is not None:
            moved = item.edges.translate(list(shift))
            plotter.add_mesh(moved, color="black", lighting=False, **edges)
        if item.ghost.n_cells:  # a round body has no sharp edge
            plotter.add_mesh(item.ghost, color="#8c8c8c", line_width=ghost, lighting=False)

    def add_solids(
        self, plotter: Any, solids: Sequence[tuple[str, pv.PolyData]], **options: Any
    ) -> None:
        """Add the solids: behind a plane body obstacles, in front of it bones and rigid shapes."""
        for kind, solid in solids:
            colour, opacity = _STYLES[kind]
            if self._flat:
                way = -self._shift if kind == "obstacles" else self._shift / 2
                solid, options = solid.translate(list(way)), _UNLIT
            plotter.add_mesh(solid, color=colour, opacity=opacity, **options)

    @property
    def _shift(self) -> np.ndarray:
        """A short displacement (3,) towards the viewer, invisible in a parallel projection."""
        return np.asarray(2e-3 * self.view.width * self.view.towards)

    def image(
        self,
        item: DrawnBody,
        solids: Sequence[tuple[str, pv.PolyData]],
        pixels: int,
        scale: int = 2,
    ) -> np.ndarray:
        """Return a panel as an RGB array (height, pixels, 3) uint8, averaged from a larger one.

        RuntimeError if OpenGL draws nothing.
        """
        where = self.view
        shape = [scale * pixels, scale * round(pixels * where.height / where.width)]
        plotter: Any = pv.Plotter(off_screen=True, window_size=shape, border=False, lighting="none")
        plotter.background_color = "white"
        for side, up, strength in LIGHTS:
            light = pv.Light(light_type="camera light", intensity=strength)
            light.position = (side, up, 1.0)
            plotter.add_light(light)
        plotter.enable_anti_aliasing("msaa", multi_samples=4)
        shift = self._shift
        self.add(
            plotter, item, {"opacity": 0.3, "line_width": pixels / 350}, pixels / 300, list(shift),
            opacity=self.job.opacity, show_scalar_bar=False,
            smooth_shading=True, split_sharp_edges=True,
            feature_angle=35, ambient=0.5, diffuse=0.8, specular=0.08, specular_power=15,
        )  # fmt: skip
        rest = item.rest.translate(list(-shift))  # behind a section in the same plane
        faces = None if is_flat(item.rest.points) else "front"
        plotter.add_mesh(rest, color="#b0b0b0", opacity=0.15, culling=faces, lighting=False)
        self.add_solids(plotter, solids, smooth_shading=True, split_sharp_edges=True)
        plotter.camera.SetParallelProjection(True)
        where.place(plotter.camera, 10 * (where.width + where.height))
        plotter.camera.parallel_scale = where.height / 2
        plotter.renderer.ResetCameraClippingRange()
        image = plotter.screenshot(return_img=True)
        plotter.close()
        if image is None or np.all(image == image[0, 0]):
            raise RuntimeError("OpenGL drew an empty picture")
        offsets = range(scale)
        averaged = np.mean([image[i::scale, j::scale] for i in offsets for j in offsets], axis=0)
        # Rounding the colours to multiples of 4 is invisible and halves the file.
        return np.minimum(4 * np.round(averaged / 4), 255).astype(np.uint8)

    @property
    def label(self) -> str:
        """The label of the colour bar, with the range of the values if it exceeds the colours'."""
        text = label(self.job.field, self.job.units)
        (low, high), ends = self.extremes, (self.norm.vmin, self.norm.vmax)
        rounding = _ROUNDING * (ends[1] - ends[0])
        if self.job.field == "mode" or not (low < ends[0] - rounding or high > ends[1] + rounding):
            return text
        values = f"values from {low:.3g} to {high:.3g}".replace("-", "\u2212")
        return f"{text}  ·  {values}, the colours end before"

    @property
    def extremes_line(self) -> str:
        """The smallest and the largest value of all panels, and their points at rest."""
        found = [
            (*end, panel.label.partition(DOT)[0])
            for body, panel in zip(self.bodies, self.job.panels, strict=True)
            for end in body.extremes
        ]
        ends = [
            f"{value:.4g} at ({', '.join(f'{x:.4g}' for x in at)}), {panel}"
            for value, (_, at, panel) in zip(self.extremes, (min(found), max(found)), strict=True)
        ]
        name = label(self.job.field, self.job.units).replace("  ", " ")
        return f"{name}: from {ends[0]}, to {ends[1]}"

    def add_colour_bar(self, figure: Figure, height: int, pixels: int) -> None:
        """Add the colour bar at the bottom of a figure ``height`` pixels high.

        If the job has units, a scale bar is beside it; panels are ``pixels`` wide.
        """
        bar = figure.add_axes((0.3, 76 / height, 0.4, 20 / height))
        most = 5 if self.job.field == "mode" else 7
        ticks, numbers = ticks_of_bar(self.norm.vmin, self.norm.vmax, most)
        figure.colorbar(
            ScalarMappable(self.norm, self.cmap), bar, orientation="horizontal",
            extend=self.extend, ticks=ticks, format=numbers,
        )  # fmt: skip
        bar.tick_params(labelsize=8)
        bar.xaxis.get_offset_text().set_fontsize(8)
        bar.set_xlabel(self.label, fontsize=8.5, labelpad=2)
        if self.job.units is None:
            return
        length = round_up(_SCALE_BAR * self.view.width)
        part = length / self.view.width * pixels / (figure.get_figwidth() * figure.dpi)
        line, at = np.array([0.0, part]) + 0.05, 86 / height
        figure.add_artist(Line2D(line, [at, at], color="black", lw=1.5, marker="|", ms=6))
        name = f"{length:g} {self.job.units.length}"
        figure.text(0.05 + part / 2, 62 / height, name, fontsize=8, ha="center", va="top")


def ticks_of_bar(low: float, high: float, most: int) -> tuple[MaxNLocator, ScalarFormatter]:
    """Return a locator of at most ``most`` ticks of a colour bar, and the ticks' format.

    Numbers are written in full, 0.9994, not as the difference to one beside the bar.
    """
    numbers = ScalarFormatter(useOffset=False, useMathText=True)
    numbers.set_powerlimits((-3, 6))  # 0.0003 beside 0.0006 overlap
    long = high - low < _LONG_NUMBERS * max(abs(low), abs(high))
    return MaxNLocator(min(most, 3) if long else most), numbers


def write_text(figure: Figure, x: float, y: float, text: str, size: float) -> Any:
    """Write a text, without formulas, centred at a point of a figure; return the artist."""
    return figure.text(x, y, text, ha="center", va="center", fontsize=size, parse_math=False)


def draw(job: Job, report: Callable[[str], object] = ignore) -> None:
    """Draw a job into ``job.out``: panels in a row, or in a column if the body is wide.

    ``report`` is called with `Drawing.extremes_line`; not for modes.
    """
    drawing = Drawing(job)
    bodies = drawing.bodies
    where, count = drawing.view, len(bodies)
    columns = count if count <= 3 else (count + 1) // 2
    if where.width > 2 * where.height:
        columns = 1 if count <= 4 else 2
    rows = -(-count // columns)
    wide = round(WIDTH / columns * (0.8 if columns == 1 else 1.0))
    wide = min(wide, round(TALLEST * where.width / where.height))
    images = [
        drawing.image(item, solids, wide)
        for item, solids in zip(bodies, drawing.solids, strict=True)
    ]
    tall = images[0].shape[0]
    height = TOP + rows * (LABEL + tall) + FOOT
    figure = Figure(figsize=(WIDTH / DPI, height / DPI), dpi=DPI)
    write_text(figure, 0.5, 1 - TOP / 2 / height, job.title, 11)
    longest = max(len(panel.label) for panel in job.panels)
    size = LABEL_SIZE * min(1.0, 0.95 * wide / (CHARACTER * longest))
    for i, (image, panel) in enumerate(zip(images, job.panels, strict=True)):
        row, column = divmod(i, columns)
        left = (WIDTH - columns * wide) // 2 + column * wide
        low = height - TOP - (row + 1) * (LABEL + tall)
        figure.figimage(image, left, low)
        x, y = (left + wide / 2) / WIDTH, (low + tall + LABEL / 3) / height
        write_text(figure, x, y, panel.label, size)
    drawing.add_colour_bar(figure, height, wide)
    options: dict[str, Any] = {"format": job.out.suffix[1:], "pil_kwargs": {"optimize": True}}
    write_file(job.out, lambda file: figure.savefig(file, dpi=DPI, **options))
    if job.field != "mode":
        report(drawing.extremes_line)


def movie_frames(job: Job, record: Record, frames: int) -> Iterator[np.ndarray]:
    """Yield the frames as RGB arrays (height, width, 3) uint8, of even height and width."""
    loads = [panel.load for panel in job.panels]
    stored = {panel.load: panel.files for panel in job.panels}
    states = InterpolatedStates(stored, job.field, job.view.hidden_cells)
    # The view and the range of colours are those of all stored states together.
    bodies = [body_of(states.grid(load), job.field, job.view) for load in loads]
    drawing = Drawing(job, bodies)
    where = drawing.view
    wide = min(_FRAME_WIDTH, round(_FRAME_TALLEST * where.width / where.height))
    names = [parameter(record, load) for load in loads]
    decimals = max(0, 2 - floor(log10(abs(names[-1] - names[0]) or 1.0)))
    figure = None
    for load in np.linspace(loads[0], loads[-1], frames):
        item = body_of(states.grid(load), job.field, job.view)
        image = drawing.image(item, drawing.solids_at(0, load), wide, scale=1)
        if figure is None:
            height = TOP + LABEL + image.shape[0] + FOOT
            height += height % 2
            figure = Figure(figsize=(_FRAME_WIDTH / DPI, height / DPI), dpi=DPI)
            canvas = FigureCanvasAgg(figure)
            write_text(figure, 0.5, 1 - TOP / 2 / height, job.title, 8)
            label = write_text(figure, 0.5, 1 - TOP / height, "", 7)
            shown = figure.figimage(image, (_FRAME_WIDTH - wide) // 2, FOOT)
            drawing.add_colour_bar(figure, height, wide)
        shown.set_data(image)
        value = float(np.interp(load, loads, names))
        label.set_text(f"{load_name(record)} {value:.{decimals}f}{load_unit(record)}")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def write_movie(
    job: Job, record: Record, count: int, report: Callable[[int, int], object] = ignore
) -> None:
    """Draw ``count`` frames and write the movie; once complete, it replaces an earlier file."""

    def frames() -> Iterator[np.ndarray]:
        for number, frame in enumerate(movie_frames(job, record, count), 1):
            yield frame
            report(number, count)

    make_folder_of(job.out)
    with replacement(job.out) as new:
        if job.out.suffix.lower() == ".gif":
            _write_gif(new, frames())
        else:
            _write_mp4(new, frames())


def _write_mp4(path: Path, frames: Iterator[np.ndarray]) -> None:
    import imageio  # a GIF needs none

    settings: dict[str, Any] = {"codec": "libx264", "quality": 6, "macro_block_size": 2}
    movie: Any = imageio.get_writer(path, fps=FRAMES_PER_SECOND, **settings)
    with movie:
        for frame in frames:
            movie.append_data(frame)


def _write_gif(path: Path, frames: Iterator[np.ndarray]) -> None:
    images = (Image.fromarray(frame).quantize(_GIF_COLOURS) for frame in frames)
    time = round(1000 / FRAMES_PER_SECOND)
    next(images).save(path, save_all=True, append_images=images, duration=time, loop=0)
