"""Draw the frames of a movie: the worker process of `fem_snh.viewing.render.movie`.

``python -m fem_snh.viewing.render.frames`` reads a `movie.MovieJob` as JSON from standard input and
prints the number of frames drawn. Exit codes: see `fem_snh.viewing.render.worker`.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from math import floor, log10
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from fem_snh.atomic_files import make_folder_of, replacement
from fem_snh.units import Units
from fem_snh.viewing.render.drawing import DPI, FOOT, LABEL, TOP, Drawing, write_text
from fem_snh.viewing.render.options import ViewOptions
from fem_snh.viewing.render.surfaces import body_of
from fem_snh.viewing.render.worker import serve
from fem_snh.viewing.states import InterpolatedStates

#: Pixels: the width of a frame, and the largest height of the body in it.
_WIDTH, _TALLEST = 1280, 720
#: Colours of a GIF's palette, which is chosen once, from the last frame.
_GIF_COLOURS = 256


def frames(job: dict[str, Any]) -> Iterator[np.ndarray]:
    """Yield the frames as RGB arrays (height, width, 3) uint8, of even height and width."""
    loads = [panel["load"] for panel in job["panels"]]
    files = [panel["files"] for panel in job["panels"]]
    options = ViewOptions(**job["view"])
    stored = dict(zip(loads, files, strict=True))
    states = InterpolatedStates(stored, job["field"], options.hidden_cells)
    # The view and the range of colours are those of all stored states together.
    bodies = [body_of(states.grid(load), job["field"], options) for load in loads]
    obstacles, units = [job["obstacles"]] * len(loads), job["units"] and Units(**job["units"])
    drawing = Drawing(job["field"], bodies, obstacles, loads, options, units=units)
    where = drawing.view
    wide = min(_WIDTH, round(_TALLEST * where.width / where.height))
    del bodies
    decimals = max(0, 2 - floor(log10(abs(job["names"][-1] - job["names"][0]) or 1.0)))
    figure = None
    for load in np.linspace(loads[0], loads[-1], job["frames"]):
        item = body_of(states.grid(load), job["field"], options)
        image = drawing.image(item, drawing.solids_at(0, load), wide, job["opacity"], scale=1)
        if figure is None:
            height = TOP + LABEL + image.shape[0] + FOOT
            height += height % 2
            figure = Figure(figsize=(_WIDTH / DPI, height / DPI), dpi=DPI)
            canvas = FigureCanvasAgg(figure)
            write_text(figure, 0.5, 1 - TOP / 2 / height, job["title"], 8)
            label = write_text(figure, 0.5, 1 - TOP / height, "", 7)
            shown = figure.figimage(image, (_WIDTH - wide) // 2, FOOT)
            drawing.add_colour_bar(figure, height, wide)
        shown.set_data(image)
        value = float(np.interp(load, loads, job["names"]))
        label.set_text(f"{job['load_name']} {value:.{decimals}f}{job['load_unit']}")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def write(job: dict[str, Any]) -> None:
    """Draw the frames and write the movie, which replaces an earlier file once it is complete."""
    out = Path(job["out"])
    make_folder_of(out)
    with replacement(out) as new:
        if out.suffix.lower() == ".gif":
            _write_gif(new, job)
        else:
            _write_mp4(new, job)


def _write_mp4(path: Path, job: dict[str, Any]) -> None:
    import imageio

    settings: dict[str, Any] = {"codec": "libx264", "quality": 6, "macro_block_size": 2}
    movie: Any = imageio.get_writer(path, fps=job["frames_per_second"], **settings)
    with movie:
        for count, frame in enumerate(frames(job), 1):
            movie.append_data(frame)
            print(count, flush=True)


def _write_gif(path: Path, job: dict[str, Any]) -> None:
    drawn = []
    for count, frame in enumerate(frames(job), 1):
        compressed = io.BytesIO()  # whole frames would need gigabytes
        Image.fromarray(frame).save(compressed, "PNG", compress_level=1)
        drawn.append(compressed)
        print(count, flush=True)
    palette = Image.open(drawn[-1]).quantize(_GIF_COLOURS)
    images = [
        Image.open(data).quantize(palette=palette, dither=Image.Dither.NONE) for data in drawn
    ]
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=round(1000 / job["frames_per_second"]),
        loop=0,
    )


if __name__ == "__main__":
    serve(write)
