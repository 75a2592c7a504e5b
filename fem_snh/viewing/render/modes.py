"""Draw the eigenmodes of a run: exaggerated, side by side, coloured by displacement."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput
from fem_snh.units import Units
from fem_snh.viewing import render
from fem_snh.viewing.render.options import WHOLE, ViewOptions

#: Frequencies below this fraction of the highest are rigid motions, drawn on request only.
_RIGID = 1e-3
_SHOWN = 6


def main(
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
    record = render.read_record(folder)
    frequencies = read_frequencies(folder, record)
    stored = render.stored_loads(folder / "modes.pvd")
    out = render.picture_path(out) if out is not None else folder / "modes.png"
    panels = []
    for number in choose(frequencies, numbers):
        if number not in stored:
            raise BadInput(f"{folder / 'modes.pvd'}: holds no mode {number}")
        files = [str(file) for file in stored[number]]
        panels.append(render.Panel(files, label(number, frequencies[number - 1])))
    shown, units = view or WHOLE, Units.of(record)
    render.draw(render.Job("mode", render.title(record), panels, str(out), view=shown, units=units))
    return out


def read_frequencies(folder: Path, record: dict[str, Any]) -> list[float]:
    """Return the eigenfrequencies [Hz] of a run's record; raise BadInput if it has none."""
    try:
        return [float(f) for f in record["modes"]["frequencies"]]
    except (KeyError, TypeError, ValueError):
        raise BadInput(
            f"{folder / 'run.json'}: this run has no modes: its scene needs a table [modes]"
        ) from None


def choose(frequencies: list[float], wanted: Sequence[float] | None) -> list[int]:
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


def label(number: int, frequency: float) -> str:
    """Return ``mode 3  ·  1.28 Hz``; a negative frequency marks an unstable mode."""
    text = f"mode {number}  ·  {abs(frequency):.4g} Hz"
    return text if frequency >= 0 else text.replace("Hz", "i Hz, unstable")
