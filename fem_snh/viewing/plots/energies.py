"""Draw the energies of runs in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from fem_snh.viewing.plots.style import colour, style
from fem_snh.viewing.render.records import unit_name

#: The energies of one run, and the styles of their lines. The sum is that of the first three.
PARTS = {
    "kinetic": "-",
    "elastic": "--",
    "potential": ":",
    "energy": "-.",
    "dissipated": (0, (1, 3)),
}


def draw_energies(ax: Axes, records: Sequence[dict[str, Any]], names: Sequence[str]) -> None:
    """Draw the energies of one run, or the sums of several, against time.

    Parameters
    ----------
    ax : Axes
        The panel.
    records : sequence of dict
        The runs' run.json, all in time.
    names : sequence of str
        Their names in the legend of the other panels, whose colours the sums have.
    """
    joule = unit_name("J", records)
    if len(records) == 1:
        for number, (key, line) in enumerate(PARTS.items()):
            times, values = energies(records[0], key)
            if any(values):
                label = "sum" if key == "energy" else key
                ax.plot(times, values, color=colour(number), ls=line, lw=1.6, label=label)
        ax.legend(frameon=False, fontsize=8)
        ax.set_ylabel(f"energy [{joule}]")
    else:
        for number, record in enumerate(records):
            times, values = energies(record, "energy")
            ax.plot(times, values, label=names[number], **style(number, len(times)))
        ax.set_ylabel(f"kinetic + elastic + potential energy [{joule}]")
    ax.set_xlabel(f"time [{unit_name('s', records)}]")


def energies(record: dict[str, Any], key: str) -> tuple[list[float], list[float]]:
    """Return times and values of an energy: at the start and after each step that converged."""
    rows = [{"time": 0.0, **record["time"]["start"]}]
    rows += [step for step in record["steps"] if step["converged"]]
    rows = [row for row in rows if row.get(key) is not None]
    return [row["time"] for row in rows], [row[key] for row in rows]
