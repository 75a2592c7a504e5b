"""The deformed surface of a run as one USD file: a mesh with points that depend on the time.

``python -m fem_snh.viewing.export.usd`` reads {"pvd", "duration", "field", "out"} as JSON from
standard input and prints the number of states written and of all. Exit codes: see
`fem_snh.viewing.render.worker`. It is a process of its own because the libraries of usd-core carry
symbols of the C++ library that gmsh would then call.

Reference: OpenUSD, *UsdGeomMesh* and *UsdGeomPrimvar*, https://openusd.org/release/api.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.viewing.export.obj import surface_of
from fem_snh.viewing.render.worker import serve
from fem_snh.viewing.states import Array, States, SurfaceFields

#: Frames from load 0 to load 1 if the run is quasi-static: two seconds of a film.
_FRAMES = 48.0
#: Frames per second, of viewers and of runs in time.
FRAMES_PER_SECOND = 24.0


def write_usd(
    out: Path,
    states: States,
    duration: float | None = None,
    report: Callable[[int, int], None] | None = None,
    field: str | None = None,
) -> Path:
    """Write the surface at all stored loads and return the path.

    The mesh ``/body`` has the same triangles at all times, with normals outwards; its points
    [length] are sampled at the stored loads, between which viewers interpolate linearly. The fields
    are primvars of the same name at the points: numbers, and vectors of three numbers; those of the
    cells are means over the cells around a point. Of a scene in time, 24 frames are a second;
    otherwise 48 frames lead from load 0 to load 1.

    Parameters
    ----------
    out : Path
        A file .usd or .usdc (binary), or .usda (text).
    states : States
        The states.
    duration : float, optional
        The end of a run in time [s].
    report : callable, optional
        Called with the numbers of states written and of all states.
    field : str, optional
        A field that colours the surface (``displayColor``), as in pictures.

    Raises
    ------
    BadInput
        If a state cannot be read or the file cannot be written.
    """
    from pxr import Sdf, Tf, Usd, UsdGeom, Vt

    nodes, triangles = surface_of(states.mesh)
    fields = SurfaceFields(states, nodes)
    colours = fields.colours(field) if field else None
    per_time = FRAMES_PER_SECOND if duration else _FRAMES
    hidden = out.with_name(f".{out.name}{out.suffix}")
    try:
        stage = Usd.Stage.CreateNew(str(hidden))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
        stage.SetFramesPerSecond(FRAMES_PER_SECOND)
        stage.SetStartTimeCode(per_time * states.loads[0])
        stage.SetEndTimeCode(per_time * states.loads[-1])
        mesh = UsdGeom.Mesh.Define(stage, "/body")
        stage.SetDefaultPrim(mesh.GetPrim())
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, "i4")))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.ravel().astype("i4")))
        points, extent = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
        primvars: dict[str, Any] = {}
        kinds = {1: (Sdf.ValueTypeNames.FloatArray, Vt.FloatArray)}
        kinds[3] = (Sdf.ValueTypeNames.Vector3fArray, Vt.Vec3fArray)
        for number, load in enumerate(states.loads):
            data = fields.read(number)
            x = np.asarray(states.mesh.points[nodes] + data["displacement"], np.float32)
            if not np.isfinite(x).all():
                raise BadInput(f"the displacement at load {load:g} is not finite")
            time = Usd.TimeCode(per_time * load)
            points.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(x)), time)
            box = np.ascontiguousarray([x.min(axis=0), x.max(axis=0)])
            extent.Set(Vt.Vec3fArray.FromNumpy(box), time)
            for name, values in data.items():
                rows = np.asarray(values, np.float32).reshape(len(nodes), -1)
                if rows.shape[1] not in kinds:
                    continue
                kind, array = kinds[rows.shape[1]]
                if name not in primvars:
                    api = UsdGeom.PrimvarsAPI(mesh)
                    primvars[name] = api.CreatePrimvar(name, kind, UsdGeom.Tokens.vertex)
                found = rows[:, 0] if rows.shape[1] == 1 else rows
                primvars[name].Set(array.FromNumpy(np.ascontiguousarray(found)), time)
            if colours and field:
                rgb = linear_rgb(colours(fields.scalar(number, field))).astype(np.float32)
                shown = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
                shown.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rgb)), time)
            if report:
                report(number + 1, len(states))
        stage.GetRootLayer().Save()
        del stage
        hidden.replace(out)
    except (Tf.ErrorException, OSError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"cannot write {out}: {reason}") from None
    finally:
        hidden.unlink(missing_ok=True)
    return out


def linear_rgb(srgb: Array) -> Array:
    """Return linear colours of sRGB colours (IEC 61966-2-1), both from 0 to 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _write(job: dict[str, Any]) -> None:
    """Write the file that a request describes, and print the progress."""
    write_usd(
        Path(job["out"]),
        States(Path(job["pvd"])),
        job["duration"],
        lambda written, count: print(written, count, flush=True),
        job["field"],
    )


if __name__ == "__main__":
    serve(_write)
