"""``fem-snh export``: the states of a run as one VTKHDF file, or its surface as OBJ or USD files.

The files of a run are read one state at a time: `fem_snh.viewing.states`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fem_snh.errors import bad_value
from fem_snh.files import make_folder_of, output_path
from fem_snh.viewing import require, run_elsewhere
from fem_snh.viewing.stored_run import StoredRun, duration

#: File types, the packages that write them beside pyvista, and the function of ``writers``.
TYPES: dict[str, tuple[tuple[str, ...], str]] = {
    ".vtkhdf": (("h5py",), "write_vtkhdf"),
    ".obj": ((), "write_obj"),
    **dict.fromkeys((".usd", ".usda", ".usdc"), (("pxr",), "write_usd")),
}
#: What a user installs for them.
_EXTRAS = {"h5py": "'fem_snh[export]'", "pxr": "'fem_snh[usd]'"}
#: Bounds of the number of OBJ files between stored loads; the names have four digits.
MIN_FRAMES, MAX_FRAMES = 2, 10_000
#: Upper bound of the time that a state takes [s], after which the process counts as hung.
_STATE_TIMEOUT = 900.0


def main(
    folder: Path,
    out: Path,
    frames: int | None = None,
    report: Callable[[int, int], None] | None = None,
    field: str | None = None,
) -> list[Path]:
    """Export the states of a run and return the paths of the files.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path
        ``NAME.vtkhdf``: one file with mesh, all fields and all stored loads. ``NAME.obj``: a
        sequence ``NAME_0000.obj``, ``NAME_0001.obj``, ... of the deformed surface.
        ``NAME.usd``, ``.usda``, ``.usdc``: the deformed surface over time.
        Of a body in a lattice, all of them have its skin.
    frames : int, optional
        Number of OBJ files, evenly spaced over the load: between the stored loads the displacement
        is interpolated by monotone cubic polynomials (PCHIP). Default: one for each stored load.
    report : callable, optional
        Called with the numbers of states written and of all states.
    field : str, optional
        A field or component that colours the vertices of OBJ and USD files, as in pictures.

    Raises
    ------
    BadInput
        For another file type, if a package is missing, or if a file cannot be read or written.
    """
    out = output_path("OUT", out)
    kind = out.suffix.lower()
    if kind not in TYPES:
        raise bad_value("OUT", str(out), f"a file {' or '.join(TYPES)}")
    if frames is not None and kind != ".obj":
        raise bad_value("--frames", frames, "a file .obj beside it")
    if frames is not None and not MIN_FRAMES <= frames <= MAX_FRAMES:
        raise bad_value("--frames", frames, f"a number from {MIN_FRAMES} to {MAX_FRAMES}")
    if field is not None and kind == ".vtkhdf":
        raise bad_value("--field", field, "a file .obj or .usd beside it")
    require("export", ("pyvista",) if field is None else ("pyvista", "matplotlib"))
    packages, writer = TYPES[kind]
    for package in packages:
        require(f"a file {kind}", (package,), _EXTRAS[package])
    run = StoredRun(folder, field)
    make_folder_of(out)
    arguments: tuple[Any, ...] = (duration(run.record), field)
    if kind == ".obj":
        arguments = frames, field
    elif kind == ".vtkhdf":
        arguments = (run.record,)
    count = frames or len(run.states)

    function, timeout = f"{__name__}.writers:{writer}", _STATE_TIMEOUT * (1 + count)
    run_elsewhere(function, out, run.pvd, *arguments, report=report, timeout=timeout)
    return [obj_path(out, number) for number in range(count)] if kind == ".obj" else [out]


def obj_path(out: Path, number: int) -> Path:
    """Return the path of a file of a sequence ``NAME_0000.obj``, ``NAME_0001.obj``, ..."""
    return out.with_name(f"{out.stem}_{number:04}{out.suffix}")
