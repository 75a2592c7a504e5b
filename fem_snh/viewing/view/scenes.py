"""Export states of a body as scenes of vtk.js: the worker process of `fem_snh.viewing.view`.

``python -m fem_snh.viewing.view.scenes`` reads a `fem_snh.viewing.view.ViewJob` as JSON from
standard input. Exit codes: see `fem_snh.viewing.render.worker`.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from trame_vtk.modules.vtk.serializers import (
    SynchronizationContext,
    extract_array_hash,
    initialize_serializers,
    reference_id,
    serialize,
)

from fem_snh.viewing.render.drawing import bounds, colours, view
from fem_snh.viewing.render.fields import label
from fem_snh.viewing.render.obstacles import Obstacles, add_solid
from fem_snh.viewing.render.surfaces import DrawnBody, body
from fem_snh.viewing.render.worker import serve

#: Of the off-screen window [pixels]; the page draws with its own size.
_WINDOW = (800, 600)


def export(job: dict[str, Any]) -> None:
    """Write the scenes 0.zip, 1.zip, ... into the job's folder, with one view and colour map."""
    field = job["field"]
    bodies = [body(state["files"], field) for state in job["states"]]
    cmap, norm, _ = colours(field, np.concatenate([b.values for b in bodies]))
    limits = bounds(bodies)
    shapes = [Obstacles(s["obstacles"]).at(s["load"], limits) for s in job["states"]]
    where = view(bodies, shapes)
    initialize_serializers()
    for number, (item, around) in enumerate(zip(bodies, shapes, strict=True)):
        plotter: Any = pv.Plotter(off_screen=True, window_size=list(_WINDOW), border=False)
        plotter.background_color = "white"
        _add(plotter, item, field, cmap, (norm.vmin, norm.vmax))
        for obstacle in around:
            add_solid(plotter, obstacle)
        camera = plotter.camera
        camera.focal_point = where.centre
        camera.position = where.centre + 2.5 * max(where.width, where.height) * where.towards
        camera.up = (0.0, 0.0, 1.0)
        plotter.renderer.ResetCameraClippingRange()
        plotter.render()
        (Path(job["folder"]) / f"{number}.zip").write_bytes(scene(plotter.render_window))
        plotter.close()


def _add(plotter: Any, item: DrawnBody, field: str, cmap: str, limits: tuple[float, float]) -> None:
    """Add the deformed body, its element edges and its edges at rest."""
    bar = {"title": label(field).replace("  ", " "), "color": "black", "vertical": True}
    plotter.add_mesh(
        item.surface,
        scalars=field,
        cmap=cmap,
        clim=limits,
        scalar_bar_args=bar,
        ambient=0.35,
        diffuse=0.75,
    )
    if item.edges is not None:
        plotter.add_mesh(item.edges, color="black", opacity=0.35, line_width=1, lighting=False)
    if item.ghost.n_cells:
        plotter.add_mesh(item.ghost, color="#8c8c8c", line_width=1, lighting=False)


def scene(window: Any) -> bytes:
    """Return a render window as vtk.js's offline viewer reads it: index.json in a zip file."""
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


if __name__ == "__main__":
    serve(export)
