"""What all graphs share: palette, axes, legend."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

# Okabe and Ito's palette, without its yellow: told apart by colour-blind readers.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
MARKERS = "osD^vP*"


def colour(index: int) -> str:
    """The colour of series ``index``."""
    return COLOURS[index % len(COLOURS)]


def subplots(panels: int) -> tuple[Figure, list[Axes]]:
    """A figure with that many panels, four of them two by two."""
    columns = panels if panels <= 3 else 2
    rows = -(-panels // columns)
    figure = Figure(figsize=(4.2 * max(columns, 1), 3.3 * rows + 0.5), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False, sharex="all").flat)
    for ax in axes[panels:]:
        ax.remove()
    for ax in axes[:panels]:
        ax.grid(True, lw=0.4, color="0.85")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelbottom=True)
        ax.yaxis.set_major_formatter(FuncFormatter(thousands))
    return figure, axes[:panels]


def style(index: int, points: int) -> dict[str, Any]:
    """Colour, marker and line of series ``index``; fewer marks on long lines."""
    return {
        "color": colour(index),
        "marker": MARKERS[index % len(MARKERS)],
        "ls": "-" if index < len(COLOURS) else "--",
        "ms": 4.5,
        "lw": 1.6,
        "markevery": max(1, points // 20),
    }


def failure(index: int) -> dict[str, Any]:
    """A cross in the colour of series ``index``."""
    return {"color": colour(index), "ls": "", "marker": "x", "ms": 7, "mew": 1.8}


def from_zero(ax: Axes) -> None:
    """A vertical axis from 0 to a little above the highest value."""
    ax.set_ylim(0, 1.06 * max(ax.dataLim.y1, 1e-12))


def thousands(value: float, _: object) -> str:
    """A tick label with its thousands set apart."""
    text = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:g}"
    return text.replace(",", "\u2009").replace("-", "\u2212")


def legend_entry(ax: Axes, label: str, marker: str) -> None:
    """A hollow mark in the legend, for what is not a series."""
    ax.add_line(Line2D([], [], ls="", marker=marker, mfc="none", mec="0.2", mew=1.5, label=label))


def legend(figure: Figure, ax: Axes) -> None:
    """One legend below all panels."""
    handles, labels = ax.get_legend_handles_labels()
    fit = int(15 * figure.get_figwidth() / (8 + max(len(label) for label in labels)))
    columns = len(labels) if len(labels) <= min(fit, 4) else max(1, min(fit, 3))
    rows = -(-len(labels) // columns)
    foot = (0.1 + 0.22 * rows) / figure.get_figheight()
    figure.set_layout_engine("constrained", w_pad=0.1, h_pad=0.06, rect=(0, foot, 1, 1 - foot))
    figure.legend(handles, labels, loc="lower center", ncols=columns, frameon=False, fontsize=9)
