"""The HTML page of a run: a viewer with its scenes, curves, step table, settings and versions."""

from __future__ import annotations

import io
import json
from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

from trame_vtk.tools.vtksz2html import HTML_VIEWER_PATH

from fem_snh.errors import BadInput
from fem_snh.viewing.plots.runs import run_figure
from fem_snh.viewing.render.records import column_label, material_name, poisson_ratio

#: Columns of the step table, in this order, as far as the steps have them.
COLUMNS = (
    "load", "time", "converged", "reason", "newton", "clamped", "linear", "lbfgs", "residual",
    "energy", "kinetic", "elastic", "potential", "dissipated",
    "volume_ratio", "min_J", "max_u", "nonfinite", "seconds",
)  # fmt: skip
#: Where vtk.js's viewer would load its icon from; the page loads nothing.
_ICON = "https://kitware.github.io/vtk-js/icon/favicon-${t}x${t}.png"


def page(record: dict[str, Any], labels: Sequence[str], scenes: Sequence[bytes]) -> str:
    """Return the page.

    Parameters
    ----------
    record : dict
        The run's run.json.
    labels : sequence of str
        The states' labels.
    scenes : sequence of bytes
        The states' scenes, from `fem_snh.viewing.view.scenes`.
    """
    title = f"{record['scene']}: {material_name(record)}, ν = {poisson_ratio(record)}"
    states = [
        {"label": label, "scene": b64encode(scene).decode()}
        for label, scene in zip(labels, scenes, strict=True)
    ]
    viewer = HTML_VIEWER_PATH.read_text(encoding="utf-8").replace(_ICON, "data:,")
    if _ICON.split("${")[0] in viewer:
        raise BadInput(f"{HTML_VIEWER_PATH}: its icon has another address: install trame-vtk 2")
    elsewhere = ("scene", "status", "steps", "versions")
    settings = {key: value for key, value in record.items() if key not in elsewhere}
    template = Template((files("fem_snh.viewing.view") / "page.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=escape(title),
        status=escape(str(record.get("status", ""))),
        last=len(states) - 1,
        curves=_curves(record),
        steps=_step_table(record),
        settings=_pairs(flatten(settings)),
        versions=_pairs(flatten(record.get("versions", {}))),
        # "</script" would end the script element, "<!--<script" the document.
        states=json.dumps(states).replace("<", "\\u003c"),
        viewer=b64encode(viewer.encode()).decode(),
    )


def _curves(record: dict[str, Any]) -> str:
    """Return the run's graphs as SVG, or why there are none."""
    try:
        figure = run_figure([record], newton=True)
    except BadInput as error:
        return f"<p>{escape(str(error))}</p>"
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]


def _step_table(record: dict[str, Any]) -> str:
    steps = record["steps"]
    columns = [name for name in COLUMNS if any(name in step for step in steps)]
    head = "".join(f"<th>{escape(column_label(name, [record]))}</th>" for name in columns)
    rows = "".join(
        ("<tr>" if step.get("converged", True) else '<tr class="failed">')
        + "".join(f"<td>{escape(cell(step.get(name)))}</td>" for name in columns)
        + "</tr>\n"
        for step in steps
    )
    return f"<table><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table>"


def _pairs(pairs: Iterable[tuple[str, Any]]) -> str:
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(cell(value))}</td></tr>\n'
        for name, value in pairs
    )
    return f"<table><tbody>{rows}</tbody></table>"


def flatten(data: dict[Any, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Yield the values of nested tables with their keys, as ``material.nu``."""
    for key, value in data.items():
        if isinstance(value, dict):
            yield from flatten(value, f"{prefix}{key}.")
        elif key == "material":  # several
            yield from flatten(dict(enumerate(value)), f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def cell(value: Any) -> str:
    """Return a value as text: numbers with six digits, lists with commas."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return ", ".join(cell(entry) for entry in value)
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
