"""The HTML page of a run: a viewer with its scenes, curves, step table, settings and versions.

`write_page` is called in a process of its own: `fem_snh.viewing.run_elsewhere`.
"""

from __future__ import annotations

import io
import json
import zipfile
from base64 import b64encode
from collections.abc import Sequence
from functools import partial
from html import escape
from importlib.resources import files
from math import isfinite
from string import Template
from typing import Any

import pandas as pd
import pyvista as pv
from trame_vtk.modules.vtk.serializers import (
    SynchronizationContext,
    extract_array_hash,
    initialize_serializers,
    reference_id,
    serialize,
)
from trame_vtk.modules.vtk.serializers.data import polydata_serializer
from trame_vtk.modules.vtk.serializers.registry import register_instance_serializer
from trame_vtk.tools.vtksz2html import HTML_VIEWER_PATH

from fem_snh.errors import BadInput
from fem_snh.files import write_file
from fem_snh.records.run_record import Record
from fem_snh.records.units import Units
from fem_snh.viewing.plots.runs import numbers, principal_result, run_table, x_of
from fem_snh.viewing.render import Job
from fem_snh.viewing.render.drawing import Drawing
from fem_snh.viewing.stored_run import (
    VECTORS,
    Panel,
    column_label,
    label,
    material_name,
    poisson_ratio,
    step_at,
)

#: Address of the icon in vtk.js's viewer; it is replaced, as the page loads nothing.
_ICON = "https://kitware.github.io/vtk-js/icon/favicon-${t}x${t}.png"

#: Size of the off-screen window [pixels]; the browser draws with the size of the page.
_SIZE = (800, 600)


def write_page(job: Job, record: Record) -> None:
    """Write the HTML page of a job's states to ``job.out``, where it replaces an earlier file.

    The process needs OpenGL.

    Parameters
    ----------
    job : Job
        What is drawn, and the file.
    record : dict
        The content of the run's run.json.

    Raises
    ------
    BadInput
        If a state cannot be drawn or the page cannot be written.
    """
    drawing = Drawing(job)
    scenes = export_scenes(drawing)
    write_file(job.out, page(record, job.field, job.panels, scenes, drawing.extremes_line))


def export_scenes(drawing: Drawing) -> list[bytes]:
    """Return a vtk.js scene (see `scene`) of each state of a drawing, all with the same view."""
    where, job = drawing.view, drawing.job
    initialize_serializers()
    # The displacement, too, which is the surface's vectors.
    fields = ["Normals", "TCoords", "Vectors"]
    register_instance_serializer(
        "vtkPolyData", partial(polydata_serializer, requested_fields=fields)
    )
    title = label(job.field, job.units).replace("  ", " ")
    scenes = []
    for item, solids in zip(drawing.bodies, drawing.solids, strict=True):
        plotter: Any = pv.Plotter(off_screen=True, window_size=list(_SIZE), border=False)
        plotter.background_color = "white"
        if VECTORS in item.surface.point_data:  # not under torsion
            item.surface.set_active_vectors(VECTORS)
        drawing.add(
            plotter, item, {"opacity": 0.35, "line_width": 1}, 1, ambient=0.35, diffuse=0.75,
            scalar_bar_args={"title": title, "color": "black", "vertical": True},
        )  # fmt: skip
        drawing.add_solids(plotter, solids)
        where.place(plotter.camera, 2.5 * max(where.width, where.height))
        plotter.renderer.ResetCameraClippingRange()
        plotter.render()
        scenes.append(scene(plotter.render_window))
        plotter.close()
    return scenes


def scene(window: Any) -> bytes:
    """Serialize a render window for vtk.js's offline viewer: return a zip file with index.json."""
    context = SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    state = serialize(None, window, reference_id(window), context, 1)
    camera = window.GetRenderers().GetFirstRenderer().GetActiveCamera()
    state["extra"] = {
        "vtkRefId": reference_id(window),
        "centerOfRotation": camera.GetFocalPoint(),
        "camera": reference_id(camera),
    }
    arrays = {
        entry["hash"]: {**entry, "content": context.get_cached_data_array(entry["hash"], False)}
        for entry in extract_array_hash(state)
    }
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("index.json", json.dumps({"hashes": arrays, "scene": state}))
    return packed.getvalue()


def page(
    record: Record,
    field: str,
    states: Sequence[Panel],
    scenes: Sequence[bytes],
    extremes: str = "",
) -> str:
    """Return the HTML text of the page.

    Parameters
    ----------
    record : dict
        The content of the run's run.json.
    field : str
        The field that the colours show.
    states : sequence of Panel
        The states.
    scenes : sequence of bytes
        The vtk.js scene of each state.
    extremes : str
        A line with the smallest and the largest value of the field.

    Raises
    ------
    BadInput
        For an unknown version of trame-vtk.
    """
    title = f"{record['scene']}: {material_name(record)}, ν = {poisson_ratio(record)}"
    rows = [step for step in record["steps"] if step.get("converged", True)]
    shown = []
    for state, packed in zip(states, scenes, strict=True):
        step = step_at(record, state.load)
        row = next((number for number, row in enumerate(rows) if row is step), None)
        shown.append({"label": state.label, "scene": b64encode(packed).decode(), "row": row})
    units = Units.of(record)
    about = _columns(record) | {
        "states": shown,
        "failed": [not step.get("converged", True) for step in record["steps"]],
        "field": field,
        "vectors": VECTORS,
        "label": label(field, units),
        "length": f" [{units.length}]" if units else "",
    }
    viewer = HTML_VIEWER_PATH.read_text(encoding="utf-8").replace(_ICON, "data:,")
    if _ICON.split("${")[0] in viewer:
        raise BadInput(f"{HTML_VIEWER_PATH}: its icon has another address: install trame-vtk 2")
    elsewhere = ("scene", "status", "steps", "versions")
    settings = {key: value for key, value in record.items() if key not in elsewhere}
    if isinstance(settings["material"], list):
        settings["material"] = dict(enumerate(settings["material"]))
    html, script = (
        (files("fem_snh.viewing") / name).read_text(encoding="utf-8")
        for name in ("page.html", "page.js")
    )
    template = Template(html)
    return template.substitute(
        title=escape(title),
        status=escape(str(record.get("status", ""))),
        extremes=escape(extremes),
        last=len(shown) - 1,
        steps=_step_table(record),
        settings=_values(settings),
        versions=_values(record.get("versions", {})),
        # "</script" would end the script element, "<!--<script" the document.
        states=json.dumps(about, allow_nan=False).replace("<", "\\u003c"),
        script=script,
        viewer=b64encode(viewer.encode()).decode(),
    )


def _columns(record: Record) -> dict[str, Any]:
    """Return the numeric columns of the converged steps, and the first curve's indices x and y.

    A value that is not finite is None. If no step has converged, there are no columns.
    """
    try:
        table = numbers(run_table(record))
    except BadInput:
        return {"columns": [], "x": 0, "y": 0}
    columns = [
        {
            "label": column_label(name, [record]),
            "values": [float(value) if isfinite(value) else None for value in table[name]],
        }
        for name in table
    ]
    # First a reaction or the volume over the load parameter.
    x, y = x_of([record]), principal_result([record]) or "volume_ratio"
    y = y if y in table else x
    return {"columns": columns, "x": list(table).index(x), "y": list(table).index(y)}


def _step_table(record: Record) -> str:
    """Return an HTML table of all steps, with the values that are no lists or dictionaries."""
    steps = [
        {name: value for name, value in step.items() if not isinstance(value, dict | list)}
        for step in record["steps"]
    ]
    labels = {name: column_label(name, [record]) for step in steps for name in step}
    return _html(pd.DataFrame(steps).rename(columns=labels), index=False)


def _values(data: dict[str, Any]) -> str:
    """Return an HTML table of nested settings: keys such as ``material.nu``, and values."""
    return _html(pd.json_normalize(data).T, header=False)


def _html(table: pd.DataFrame, **options: Any) -> str:
    """Return a table as HTML: numbers with six digits, missing values empty."""
    with pd.option_context("display.max_colwidth", None):
        return str(table.to_html(border=0, na_rep="", float_format="{:.6g}".format, **options))
