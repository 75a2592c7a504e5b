"""Draw the report of a material (`fem_snh.kernels.reports.report.Report`) in one picture."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill, shorten
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from fem_snh.viewing.plots import save
from fem_snh.viewing.plots.style import COLOURS, colour, plain, thousands
from fem_snh.viewing.render.records import pretty

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
_SIZE, _LEGEND = (15, 7.6), 0.06
#: Greatest stress that is drawn, in multiples of that of linear elasticity.
_MOST_STRESS = 2.5
#: Margin below and above a curve, as a fraction of its height.
_MARGIN = 0.05
#: Smallest height of an axis, for curves that are zero.
_LEAST_HEIGHT = 1e-12
#: Eigenvalues above -_ROUNDING [E] are drawn as non-negative.
_ROUNDING = 1e-8
#: Heights in the panel of verdicts: the top, a reason below its verdict, and the next verdict.
_TOP, _REASON, _ROW = 0.97, 0.065, 0.145
#: Characters of a reason that fit into its panel.
_LONGEST_REASON = 62
#: Colour of each verdict of `fem_snh.kernels.reports.stability`.
_VERDICTS = {"passed": COLOURS[2], "failed": COLOURS[1], "not applicable": "0.45"}
_LABELS = {
    "uniaxial": ("stretch", r"$P_{00}/E$"),
    "equibiaxial": ("stretch", r"$P_{00}/E$"),
    "simple shear": ("amount of shear", r"$P_{01}/E$"),
    "volumetric": ("stretch in all directions", r"$P_{00}/E$"),
}


def main(report: Any, out: Path) -> Path:
    """Draw a report into the file ``out``; raise BadInput if it cannot be written."""
    return save(material_figure(report), out)


def material_figure(report: Any) -> Figure:
    """Return a figure of stress curves, regions of a positive tangent and stability."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    grid = figure.add_gridspec(2, 4)
    axes = [figure.add_subplot(grid[divmod(n, 4)]) for n in range(6)]
    for ax, curve in zip(axes, report.curves, strict=False):
        _test(ax, curve, report.E)
    axes[0].legend(frameon=False, fontsize=9)
    for ax, region in zip(axes[4:6], report.regions, strict=True):
        _tangent(ax, region, report)
    _verdicts(figure.add_subplot(grid[1, 2:]), report)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    handles = [
        Patch(facecolor=shade, edgecolor="0.6", label=text)
        for shade, text in zip(SHADES[::-1], MEANINGS[::-1], strict=True)
    ]
    area = (0, _LEGEND, 1, 1 - _LEGEND)
    figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.08, rect=area)
    figure.legend(
        handles=handles, loc="lower left", ncols=4, frameon=False, fontsize=9, title_fontsize=9,
        title="exact tangent", alignment="left",
    )  # fmt: skip
    own = [f"{k} = {v}" for k, v in report.shape.items() if v is not None]
    title = "  ·  ".join([plain(pretty(report.name)), rf"$\nu$ = {report.nu:g}", *map(plain, own)])
    figure.suptitle(fill(title, 140), fontsize=13)
    return figure


def _test(ax: Axes, curve: Any, E: float) -> None:
    """Draw stress against stretch beside linear elasticity, whose range bounds the axis."""
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
    """Draw a grid, and lines through the state at rest."""
    ax.grid(True, lw=0.4, color="0.88")
    ax.set_axisbelow(True)
    ax.axhline(0, lw=0.8, color="0.6", zorder=1)
    ax.axvline(rest, lw=0.8, color="0.6", zorder=1)


def _tangent(ax: Axes, region: Any, report: Any) -> None:
    """Draw the kinds of tangent in a plane, the rest state and the path of the uniaxial test."""
    zero = -_ROUNDING * report.E
    kind = np.where(region.tangent >= zero, 3, np.where(region.scaling >= zero, 2, 1))
    kind[~np.isfinite(region.tangent)] = 0
    ax.pcolormesh(
        region.s0, region.s1, kind, cmap=ListedColormap(SHADES), vmin=0, vmax=3, shading="nearest"
    )
    if region.plane == "s2 = s1":
        s = report.curves[0].stretches
        ax.plot(s[:, 0], s[:, 1], color="black", lw=1.2)
        last = np.flatnonzero((s[:, 0] < 2.9) & np.isfinite(s[:, 1]))[-1:]
        for k in last:
            ax.annotate(
                "uniaxial", s[k, :2], (-2, 6), textcoords="offset points", ha="right", fontsize=9
            )
    ax.plot(1, 1, "o", ms=6, mfc="white", mec="black")
    ax.set(xlim=(0, region.s0[-1]), ylim=(0, region.s1[-1]), aspect="equal")
    sign = region.plane.replace("s2", r"\sigma_2").replace("s1", r"\sigma_1")
    ax.set_title(f"exact tangent, ${sign}$", fontsize=11)
    ax.set_xlabel(r"$\sigma_0$")
    ax.set_ylabel(r"$\sigma_1$")


def _verdicts(ax: Axes, report: Any) -> None:
    """Write the verdicts on stability and the constants."""
    ax.set_axis_off()
    ax.set_title("stability", fontsize=11)
    y = _TOP
    for s in report.stabilities:
        ax.text(0.0, y, s.name, fontsize=10, va="top", transform=ax.transAxes)
        ax.text(
            0.36, y, s.verdict, fontsize=10, va="top", weight="bold", transform=ax.transAxes,
            color=_VERDICTS[s.verdict],
        )  # fmt: skip
        reason = shorten(s.reason, _LONGEST_REASON, placeholder="...")
        ax.text(
            0.0, y - _REASON, reason, fontsize=8.5, va="top", color="0.35", transform=ax.transAxes
        )
        y -= _ROW
    mu, lam = report.mu_lame / report.E, report.lambda_lame / report.E
    stress = report.rest_stress / report.E if report.rest.verdict == "failed" else 0.0
    numbers = rf"$\mu$ = {mu:.4g} E,  $\lambda$ = {lam:.4g} E,  stress at rest {stress:.3g} E"
    ax.text(0.0, y - 0.02, numbers, fontsize=9, va="top", transform=ax.transAxes)
