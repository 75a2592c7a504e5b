"""Draw the report of a material (`fem_snh.kernels.reports.report.Report`), or fits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from fem_snh.viewing.plots import save
from fem_snh.viewing.plots.style import colour, draw_points, legend, plain, subplots, thousands
from fem_snh.viewing.stored_run import pretty

MATERIAL, LINEAR = colour(0), "0.45"
#: Colours of the kinds of tangent, in the order of ``MEANINGS``.
SHADES = ("0.80", "white", "#B9DCF0", "#0072B2")
MEANINGS = (
    "infinite energy",
    "negative scaling eigenvalue",
    "scaling eigenvalues ≥ 0",
    "all nine eigenvalues ≥ 0",
)
#: Size of the picture [inches], and the strip at its bottom that the legend of the tangents takes,
#: as a fraction of the height.
_SIZE, _LEGEND = (12, 7.6), 0.06
#: Largest stress that is drawn, in multiples of the largest stress of linear elasticity.
_MOST_STRESS = 2.5
#: Margin below and above a curve, as a fraction of its height.
_MARGIN = 0.05
#: Smallest height of an axis, for curves that are zero.
_LEAST_HEIGHT = 1e-12
#: Eigenvalues above -_ROUNDING [E] are drawn as non-negative.
_ROUNDING = 1e-8
_LABELS = {
    "uniaxial": ("stretch", r"$P_{00}/E$"),
    "equibiaxial": ("stretch", r"$P_{00}/E$"),
    "simple shear": ("amount of shear", r"$P_{01}/E$"),
    "volumetric": ("stretch in all directions", r"$P_{00}/E$"),
}


def draw_report(report: Any, out: Path) -> Path:
    """Draw a report into ``out`` and return the path; raise BadInput if it cannot be written."""
    return save(material_figure(report), out)


def material_figure(report: Any) -> Figure:
    """Return a figure of a report: stress curves, and regions of a positive exact tangent."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.subplots(2, 3).flat
    for ax, curve in zip(axes, report.curves, strict=False):
        _test(ax, curve, report.E)
    axes[0].legend(frameon=False, fontsize=9)
    for ax, region in zip(axes[4:], report.regions, strict=True):
        _tangent(ax, region, report)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    handles: list[Artist] = [
        Patch(facecolor=shade, edgecolor="0.6", label=text)
        for shade, text in zip(SHADES[::-1], MEANINGS[::-1], strict=True)
    ]
    handles.append(Line2D([], [], color="black", lw=1.2, label="uniaxial test"))
    area = (0, _LEGEND, 1, 1 - _LEGEND)
    figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.08, rect=area)
    figure.legend(
        handles=handles, loc="lower left", ncols=5, frameon=False, fontsize=9, title_fontsize=9,
        title="exact tangent", alignment="left",
    )  # fmt: skip
    own = [f"{k} = {v}" for k, v in report.shape.items() if v is not None]
    title = "  ·  ".join([plain(pretty(report.name)), rf"$\nu$ = {report.nu:g}", *map(plain, own)])
    figure.suptitle(fill(title, 110), fontsize=13)
    return figure


def _test(ax: Axes, curve: Any, E: float) -> None:
    """Draw stress / E of a test and of linear elasticity, which bounds the vertical axis."""
    stress, linear = curve.stress / E, curve.linear / E
    ax.plot(curve.x, linear, color=LINEAR, ls="--", lw=1.3, label="linear elasticity")
    ax.plot(curve.x, stress, color=MATERIAL, lw=2, label="material")
    limit = _MOST_STRESS * max(float(np.abs(linear).max()), _LEAST_HEIGHT)
    known = np.append(linear, stress[np.isfinite(stress)])
    low, high = max(known.min(), -limit), min(known.max(), limit)
    margin = _MARGIN * (high - low)
    ax.set_ylim(low - margin, high + margin)
    ax.set_xlim(curve.x[0], curve.x[-1])
    solved = np.flatnonzero(np.isfinite(stress))
    for end, last in ((solved[:1], 0), (solved[-1:], len(stress) - 1)):
        if len(end) and end[0] != last:  # the branch of stress-free sides ends here
            ax.plot(curve.x[end], stress[end], "x", color=MATERIAL, ms=8, mew=2)
    _cross_hairs(ax, 0.0 if curve.name == "simple shear" else 1.0)
    ax.set_title(curve.name, fontsize=11)
    ax.set_xlabel(_LABELS[curve.name][0])
    ax.set_ylabel(_LABELS[curve.name][1])
    ax.yaxis.set_major_formatter(FuncFormatter(thousands))


def _cross_hairs(ax: Axes, rest: float) -> None:
    """Draw a grid, and lines through the undeformed state, which is at (``rest``, 0)."""
    ax.grid(True, lw=0.4, color="0.88")
    ax.set_axisbelow(True)
    ax.axhline(0, lw=0.8, color="0.6", zorder=1)
    ax.axvline(rest, lw=0.8, color="0.6", zorder=1)


def _tangent(ax: Axes, region: Any, report: Any) -> None:
    """Draw the kinds of tangent (`MEANINGS`) in a plane of principal stretches.

    A circle marks the undeformed state, and a line the uniaxial test in the plane s2 = s1.
    """
    zero = -_ROUNDING * report.E
    kind = np.where(region.tangent >= zero, 3, np.where(region.scaling >= zero, 2, 1))
    kind[~np.isfinite(region.tangent)] = 0
    ax.pcolormesh(
        region.s0, region.s1, kind, cmap=ListedColormap(SHADES), vmin=0, vmax=3, shading="nearest"
    )
    if region.plane == "s2 = s1":
        s = report.curves[0].stretches
        ax.plot(s[:, 0], s[:, 1], color="black", lw=1.2)
    ax.plot(1, 1, "o", ms=6, mfc="white", mec="black")
    ax.set(xlim=(0, region.s0[-1]), ylim=(0, region.s1[-1]), aspect="equal")
    sign = region.plane.replace("s2", r"\sigma_2").replace("s1", r"\sigma_1")
    ax.set_title(f"exact tangent, ${sign}$", fontsize=11)
    ax.set_xlabel(r"$\sigma_0$")
    ax.set_ylabel(r"$\sigma_1$")


#: Points of a curve.
_POINTS = 300
#: An extrapolated curve is longer than the range of the data by this factor.
_BEYOND = 1.25
#: The stress axis ends at this multiple of the largest measured stress; extrapolations are cut off.
_STRESS_BEYOND = 1.5
#: Colour of the stretches at which a fit is unstable.
_UNSTABLE = "0.92"
_AXES = {"simple_shear": "amount of shear"}
_STRESSES = {
    "stress_2": "nominal stress, direction 2",
    "stress_difference": "true stress, direction 1 minus 2",
}


def draw_fits(fits: Sequence[Any], out: Path) -> Path:
    """Draw fits of the same data into ``out`` and return the path, as `draw_report`."""
    return save(fit_figure(fits), out)


def fit_figure(fits: Sequence[Any]) -> Figure:
    """Return a figure of data, fits and extrapolations, a panel per kind and measure of test."""
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
    """Draw biaxial tests of a measure and each fit at their points; ``size`` divides stresses."""
    mine = [t.data for t in fits[0].tests if (t.data.kind, t.data.measure) == ("biaxial", measure)]
    for place, t in enumerate(mine):
        draw_points(ax, place, t.x, t.stress / size, "data" if len(mine) == 1 else t.name)
        for number, f in enumerate(fits):
            stress = f.stress("biaxial", t.x, t.stretch_2, measure) / size
            label = "_" if place else plain(pretty(f.name))  # the legend has a fit once
            ax.plot(t.x, stress, "x", color=colour(number), label=label)


def _draw(ax: Axes, kind: str, fits: Sequence[Any], size: float) -> None:
    """Draw the data of one kind of test and the curve of each fit; ``size`` divides stresses."""
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
        draw_points(ax, number, t.x, t.stress / size, "data" if len(mine) == 1 else t.name)
    known = np.concatenate([t.stress for t in mine]) / size
    span = _STRESS_BEYOND * float(np.abs(known).max())
    ax.set_ylim(-span if known.min() < 0 else 0.0, span if known.max() > 0 else 0.0)
    ax.set_xlim(low, end)


def draw_curve(curve: Any, fitted: Any, out: Path) -> Path:
    """Draw measured and ``fitted`` (points, goals) goals of a scene; return the path ``out``."""
    figure, axes = subplots(1, share=False)
    (ax,) = axes
    for number, name in enumerate(curve.names):
        known = np.isfinite(fitted[:, number])
        x = curve.x[known]
        measured = curve.values[known, number]
        draw_points(ax, number, x, measured, f"{name}, measured", colour(number))
        label = f"{plain(name)}, fitted"
        ax.plot(x, fitted[known, number], color=colour(number), lw=1.8, label=label)
    ax.set_xlabel(plain(curve.label))
    legend(figure, ax)
    return save(figure, out)
