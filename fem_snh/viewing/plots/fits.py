"""Draw fits of materials to test data (`fem_snh.studies.fit.Fit`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fem_snh.viewing.plots import save
from fem_snh.viewing.plots.style import MARKERS, colour, legend, plain, subplots
from fem_snh.viewing.render.records import pretty

#: Points of a curve.
_POINTS = 300
#: An extrapolation goes beyond the data by this factor.
_BEYOND = 1.25
#: The axis of stresses shows this multiple of the data; extrapolations leave it.
_MOST_STRESS = 1.5
#: Colour of the stretches at which a fit is unstable.
_UNSTABLE = "0.92"
_AXES = {"simple_shear": "amount of shear"}
_STRESSES = {
    "stress_2": "nominal stress, direction 2",
    "stress_difference": "true stress, direction 1 minus 2",
}


def main(fits: Sequence[Any], out: Path) -> Path:
    """Draw fits of the same data into ``out``; raise BadInput if it cannot be written."""
    return save(fit_figure(fits), out)


def fit_figure(fits: Sequence[Any]) -> Figure:
    """Return a figure with a panel for each kind of test: data, fits and their extrapolations."""
    tests = fits[0].tests
    panels = list(dict.fromkeys((t.data.kind, t.data.measure) for t in tests))
    figure, axes = subplots(len(panels), share=False)
    largest = max(float(np.abs(t.data.stress).max()) for t in tests)
    power = 3 * int(np.floor(np.log10(largest) / 3)) if largest >= 1e3 else 0
    size = 10.0**power
    before = None
    for ax, (kind, measure) in zip(axes, panels, strict=True):
        ax.set_title(kind.replace("_", " "), fontsize=11)
        if kind == "biaxial":
            _draw_biaxial(ax, measure, fits, size)
        else:
            _draw(ax, kind, fits, size)
        ax.set_xlabel(_AXES.get(kind, "stretch"))
        label = _STRESSES.get(measure, "nominal stress")
        if label != before:
            ax.set_ylabel(label + (f" [1e{power}]" if power else ""))
        before = label
    legend(figure, axes[0])
    return figure


def _draw_biaxial(ax: Axes, measure: str, fits: Sequence[Any], size: float) -> None:
    """Draw the data and the fits of biaxial tests.

    There is a curve for each second stretch, which stands at its end; if most points have one of
    their own, there is one curve through the points.
    """
    mine = [t.data for t in fits[0].tests if (t.data.kind, t.data.measure) == ("biaxial", measure)]
    labels = [plain(pretty(f.name)) for f in fits]
    for place, t in enumerate(mine):
        curves = [t.stretch_2 == y for y in np.unique(t.stretch_2)]
        if 2 * len(curves) > len(t.x):
            curves = [np.full(len(t.x), True)]
        for curve in curves:
            x, y = t.x[curve], t.stretch_2[curve]
            along = np.linspace(0, len(x) - 1, _POINTS)
            grid, second = (np.interp(along, np.arange(len(x)), s) for s in (x, y))
            for number, f in enumerate(fits):
                stress = f.stress("biaxial", grid, second, measure) / size
                ax.plot(grid, stress, color=colour(number), lw=1.8, label=labels[number])
            labels = ["_"] * len(fits)  # the legend has a fit once
            if len(curves) > 1:
                ax.set_title(r"biaxial; $\lambda_2$ at the curves", fontsize=11)
                last = x.argmax()
                ax.annotate(f"{y[0]:g}", (x[last], t.stress[curve][last] / size), (4, 3),
                            textcoords="offset points", fontsize=8)  # fmt: skip
        ax.plot(
            t.x, t.stress / size, ls="", marker=MARKERS[place % len(MARKERS)], mfc="white",
            mec="0.2", ms=5, label="data" if len(mine) == 1 else plain(t.name),
        )  # fmt: skip
    ax.margins(x=0.1)


def _draw(ax: Axes, kind: str, fits: Sequence[Any], size: float) -> None:
    """Draw the data of one kind of test, and the curve of each fit."""
    mine = [t.data for t in fits[0].tests if t.data.kind == kind]
    x = np.concatenate([t.x for t in mine])
    rest = mine[0].rest
    low, high = min(rest, float(x.min())), max(rest, float(x.max()))
    end = high if len(fits) > 1 else rest + _BEYOND * (high - rest)
    grid = np.linspace(low, end, _POINTS)
    for number, f in enumerate(fits):
        stress = f.stress(kind, grid) / size
        label = plain(pretty(f.name))
        inside = grid <= high
        ax.plot(grid[inside], stress[inside], color=colour(number), lw=1.8, label=label)
        if (~inside).any():
            ax.plot(grid[~inside], stress[~inside], color=colour(number), lw=1.4, ls=":",
                    label="extrapolation")  # fmt: skip
        for s in f.stable:
            if s.kind == kind and len(fits) == 1 and s.high < min(end, s.searched[1]):
                ax.axvspan(s.high, end, color=_UNSTABLE, label="unstable (Drucker)")
    for number, t in enumerate(mine):
        ax.plot(
            t.x, t.stress / size, ls="", marker=MARKERS[number % len(MARKERS)], mfc="white",
            mec="0.2", ms=5, label="data" if len(mine) == 1 else plain(t.name),
        )  # fmt: skip
    known = np.concatenate([t.stress for t in mine]) / size
    span = _MOST_STRESS * float(np.abs(known).max())
    ax.set_ylim(-span if known.min() < 0 else 0.0, span if known.max() > 0 else 0.0)
    ax.set_xlim(low, end)


def draw_curve(curve: Any, fitted: Any, out: Path) -> Path:
    """Draw measured and fitted goals of a scene; raise BadInput if ``out`` cannot be written."""
    figure, axes = subplots(1, share=False)
    (ax,) = axes
    for number, name in enumerate(curve.names):
        known = np.isfinite(fitted[:, number])
        x = curve.x[known]
        ax.plot(
            x, curve.values[known, number], ls="", marker=MARKERS[number % len(MARKERS)],
            mfc="white", mec=colour(number), ms=5, label=f"{plain(name)}, measured",
        )  # fmt: skip
        label = f"{plain(name)}, fitted"
        ax.plot(x, fitted[known, number], color=colour(number), lw=1.8, label=label)
    ax.set_xlabel(plain(curve.label))
    legend(figure, ax)
    return save(figure, out)
