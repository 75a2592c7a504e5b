"""Export states of a body as scenes of vtk.js: the worker process of `fem_snh.viewing.view`.

``python -m fem_snh.viewing.view.scenes`` reads a `fem_snh.viewing.render.Job` as JSON from
standard input. Exit codes: see `fem_snh.viewing.render.worker`.
"""

from __future__ import annotations

import io
import json
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

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

from fem_snh.viewing.render.drawing import Drawing, extremes_line
from fem_snh.viewing.render.fields import VECTORS, label
from fem_snh.viewing.render.worker import serve

#: Of the off-screen window [pixels]; the page draws with its own size.
_WINDOW = (800, 600)


def export(job: dict[str, Any]) -> None:
    """Write the scenes 0.zip, 1.zip, ... of a `render.Job` into its folder, with one view."""
    drawing, bodies = Drawing.of(job)
    where = drawing.view
    initialize_serializers()
    # The displacement, too, which is the surface's vectors.
    fields = ["Normals", "TCoords", "Vectors"]
    register_instance_serializer(
        "vtkPolyData", partial(polydata_serializer, requested_fields=fields)
    )
    title = label(drawing.field, drawing.units).replace("  ", " ")
    for number, (item, solids) in enumerate(zip(bodies, drawing.solids, strict=True)):
        plotter: Any = pv.Plotter(off_screen=True, window_size=list(_WINDOW), border=False)
        plotter.background_color = "white"
        if VECTORS in item.surface.point_data:  # not of a revolved section
            item.surface.set_active_vectors(VECTORS)
        drawing.add(
            plotter, item, {"opacity": 0.35, "line_width": 1}, 1, ambient=0.35, diffuse=0.75,
            scalar_bar_args={"title": title, "color": "black", "vertical": True},
        )  # fmt: skip
        drawing.add_solids(plotter, solids)
        where.place(plotter.camera, 2.5 * max(where.width, where.height))
        plotter.renderer.ResetCameraClippingRange()
        plotter.render()
        (Path(job["out"]) / f"{number}.zip").write_bytes(scene(plotter.render_window))
        plotter.close()
    print(extremes_line(drawing, bodies, job), flush=True)


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
