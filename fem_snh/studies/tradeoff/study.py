"""Run a study of accuracy against cost: a grid of runs per Poisson's ratio, a table, advice.

    >>> table = tradeoff("cook", "out/cook", nus=[0.3, 0.4999], timeout=60)

The folder holds tradeoff.json (the definition), tradeoff.csv (a row is appended when a point ends;
its errors are added when all points of its nu have ended), tradeoff.png, advice.csv, advice.md, and
one folder per point with its run and its log. A study continues when it is called again, also with
more values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh import scenes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.choices import HESSIANS
from fem_snh.errors import BadInput, choose
from fem_snh.files import is_shape, replace_file
from fem_snh.studies.batch import Batch
from fem_snh.studies.point import Limits
from fem_snh.studies.scene_points import file_digests, scene_files
from fem_snh.studies.sweep import one_variant
from fem_snh.studies.table import MEASURED, REQUESTED
from fem_snh.studies.tradeoff import advice, errors
from fem_snh.studies.tradeoff.grid import Plan, resolutions
from fem_snh.studies.tradeoff.knobs import AUTOMATIC, KNOBS, SOLVERS
from fem_snh.studies.tradeoff.reference import CANDIDATES, LOCKING_FREE, MESHES

_FEATURES = ("mesh", "solver", "forcing", "tolerance", "default")
_COST = ("cpu", "peak_memory_mb", "h", "linear_solver")


def tradeoff(
    scene: str | Path,
    out: str | Path,
    *,
    nus: Sequence[float] = (),
    elements: Sequence[str] = (),
    meshes: Sequence[int | str] = (),
    base: Mapping[str, Any] | None = None,
    vary: Sequence[str] = KNOBS,
    vary_at: Sequence[float] | None = None,
    full: bool = False,
    overrides: Mapping[str, Any] | None = None,
    petsc: Mapping[str, Any] | None = None,
    report: Callable[[str], None] = print,
    **limits: Any,
) -> pd.DataFrame:
    """Run the points of a study that have no row yet and return its table, tradeoff.csv.

    Parameters
    ----------
    scene : str | Path
        A name or a .toml file.
    out : str | Path
        The folder; a study that it holds is continued.
    nus : sequence of float
        Poisson's ratios; default: that of the scene.
    elements : sequence of str
        Names; default: all that the meshes allow.
    meshes : sequence of int | str
        Cells or mesh files for every element, coarse to fine; default: those of the scene.
    base : mapping, optional
        Other defaults of the knobs (hessian, solver, forcing, tolerance) and of the
        number of load steps.
    vary : sequence of str
        The knobs that are varied.
    vary_at : sequence of float, optional
        Poisson's ratios at which they are varied; None: all.
    full : bool
        Run every combination of the knobs on every mesh, instead of one at a time on one mesh.
    overrides : mapping, optional
        Other values of the scene, as for `fem_snh.scenes.load`.
    petsc : mapping, optional
        PETSc options of every point; they take precedence over the knobs.
    report : callable
        Called with one line per point and per reference.
    limits : Any
        Jobs, ranks, timeout, memory, retry, overwrite, as for `fem_snh.studies.sweep.sweep`.

    Returns
    -------
    pandas.DataFrame
        One row per point, with its errors.

    Raises
    ------
    BadInput
        Before anything runs: for a bad value, or if ``out`` holds another study.
    """
    overrides, flags = dict(overrides or {}), {k: limits.pop(k, False) for k in _FLAGS}
    own = scenes.load(scene, **overrides)
    other, taken = _without_nu(overrides)
    if nus and taken:
        raise BadInput(f"nu and {taken}: expected one of them")
    plan = _plan(own, nus, elements, meshes, dict(base or {}), vary, vary_at, full)
    of = errors.quantities([str(r.group) for r in own.reactions], [p.name for p in own.probe])
    if not own.probe:
        raise BadInput(f"{scene}: has no probe: expected a table [[probe]] with name and point")
    parts = [column for components in of.values() for column in components]
    values = [column for column in parts if column not in MEASURED]
    columns = [
        "point",
        *(a for a in REQUESTED if a not in _FEATURES),
        *_FEATURES,
        "ranks",
        *MEASURED,
    ]
    options = dict(petsc or {})
    shared = {"scene": str(scene), "values": overrides, "petsc": options}
    batch = Batch(
        out,
        "tradeoff",
        shared | {"files": file_digests(scene, [own])},
        [*columns, *_COST, *values, *errors.columns(of)],
        Limits(**limits),
        inputs=[*scene_files(scene, [own]), *(Path(m) for m in meshes if isinstance(m, str))],
        report=report,
        **flags,
    )
    studied = {nu: plan.points(scene, nu, other, options) for nu in plan.nus}
    loaded = [point.scene for points in studied.values() for point in points.values()]
    if loaded and (keys := one_variant(loaded, report)(loaded[0])):
        studied = {nu: plan.points(scene, nu, other | keys, options) for nu in plan.nus}
    with batch:
        batch.register(
            {name: point for points in studied.values() for name, point in points.items()}
        )
        found = [plan.resolutions.get(element, []) for element in LOCKING_FREE]
        if max(map(len, found)) < MESHES:
            batch.report(
                "no reference from these points alone, thus no errors: needs "
                f"{CANDIDATES} on three meshes"
            )
        complete = []
        for nu, points in studied.items():
            complete.append(batch.run(points, _measured))
            if complete[-1]:
                _assess(batch, of, nu)
        table = pd.read_csv(batch.table.path)
        if all(complete):
            write_advice(table, batch.out)
            if table["error_displacement"].notna().any():  # there is nothing to draw without
                batch.draw()
    return table


_FLAGS = ("retry", "overwrite")


def write_advice(table: pd.DataFrame, out: Path) -> None:
    """Write advice.csv and advice.md into a folder."""
    replace_file(out / "advice.csv", advice.advice(table).to_csv(index=False, float_format="%.6g"))
    replace_file(out / "advice.md", advice.page(table))


def _without_nu(overrides: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Return the values of a scene without Poisson's ratio, and what set it, if anything did."""
    other, taken = dict(overrides), ""
    for key in ("nu", "material.nu"):
        if other.pop(key, None) is not None:
            taken = key
    material = other.get("material")
    if isinstance(material, Mapping) and "nu" in material:
        taken, other["material"] = "material", {k: v for k, v in material.items() if k != "nu"}
    return other, taken


def _plan(
    own: scenes.Scene,
    nus: Sequence[float],
    elements: Sequence[str],
    meshes: Sequence[int | str],
    base: dict[str, Any],
    vary: Sequence[str],
    vary_at: Sequence[float] | None,
    full: bool,
) -> Plan:
    """Return the plan of a study; raise BadInput for a setting that no element can have."""
    for element in elements:
        choose("element", element, ELEMENTS)
    stems = [Path(mesh).stem for mesh in meshes if isinstance(mesh, str)]
    if len(set(stems)) < len(stems):
        raise BadInput(f"meshes {', '.join(stems)}: rows are named by them, so no two may be alike")
    for knob in vary:
        choose("vary", knob, KNOBS)
    for knob in base:
        choose("default", knob, (*KNOBS, "steps"))
    if "hessian" in base:
        choose("hessian", base["hessian"], (AUTOMATIC, *HESSIANS))
    if "solver" in base:  # an element without this solver keeps its default
        choose("solver", base["solver"], list(dict.fromkeys(chain(*SOLVERS.values()))))
    nus = list(dict.fromkeys(nus)) or [own.nu]
    names = list(elements) or fitting(own, meshes)
    options = {"forcing": "snes_forcing_max", "tolerance": "snes_scaled_tol"}
    scene_values = {key: own.petsc.get(option) for key, option in options.items()}
    base = {key: value for key, value in scene_values.items() if value is not None} | base
    lists = resolutions(own, names, meshes)
    plan = Plan(nus, names, lists, base, vary, vary_at, full)
    for nu in nus:
        if not plan.choices(nu):
            raise BadInput(f"nu = {nu}: none of {', '.join(names)} can have it; use P2P1 or Q2Q1")
    return plan


def fitting(own: scenes.Scene, meshes: Sequence[int | str]) -> list[str]:
    """Return the elements that the meshes allow: of a mesh file only those of its cell type."""
    files = [mesh for mesh in meshes if isinstance(mesh, str)]
    if not files and not isinstance(own.mesh, Path):
        return list(ELEMENTS)
    from fem_snh.mesh import gmsh_input

    path = Path(files[0]) if files else own.mesh
    try:
        cell = "tetrahedron" if is_shape(path) else gmsh_input.read(str(path)).cell
    except OSError as error:
        raise BadInput(f"mesh '{path}' cannot be read: {error.strerror or error}") from None
    return [name for name, element in ELEMENTS.items() if element.cell == cell]


def _measured(record: Mapping[str, Any], row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of the cost of a point."""
    cells, count = row.get("cells"), row.get("num_cells")
    return {
        "cpu": record.get("processor_seconds"),
        "peak_memory_mb": record.get("peak_memory_mb"),
        "linear_solver": record.get("linear_solver"),
        "h": 1 / cells if cells else (count ** (-1 / 3) if count else None),
    }


def _assess(batch: Batch, of: Mapping[str, list[str]], nu: float) -> None:
    """Write the errors of the rows of one nu into the table."""
    rows = batch.table.rows()
    numbers = pd.read_csv(batch.table.path)
    mine = numbers[numbers["nu"] == nu]
    if mine.empty:
        return
    found = errors.assess(mine, of, lambda line: batch.report(f"  nu = {nu:g}, {line}"))
    for at, values in found[[c for c in errors.columns(of) if c in found]].iterrows():
        rows[at] |= {c: "" if v != v else repr(float(v)) for c, v in values.items()}
    batch.table.replace(rows)
