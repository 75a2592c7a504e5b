"""``fem-snh export``: the states of a run as one VTKHDF file, or its surface as OBJ files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fem_snh.errors import bad_value
from fem_snh.files import make_folder_of, output_path
from fem_snh.viewing import require, run_elsewhere
from fem_snh.viewing.stored_run import StoredRun

#: File types, and the function of ``writers`` for each.
TYPES = {".vtkhdf": "write_vtkhdf", ".obj": "write_obj"}
#: Upper bound of the time that a state takes [s], after which the process counts as hung.
_STATE_TIMEOUT = 900.0


def main(
    folder: Path,
    out: Path,
    report: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Export the states of a run and return the paths of the written files.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    out : Path
        ``NAME.vtkhdf``: one file with mesh, all fields and all stored loads. ``NAME.obj``: a
        sequence ``NAME_0000.obj``, ``NAME_0001.obj``, ... of the deformed surface, one for each
        stored load. For a body in a lattice, the files hold its skin.
    report : callable, optional
        Called with the number of states written and the number of all states.

    Raises
    ------
    BadInput
        For another file type, if a package is missing, or if a file cannot be read or written.
    """
    out = output_path("OUT", out)
    kind = out.suffix.lower()
    if kind not in TYPES:
        raise bad_value("OUT", str(out), f"a file {' or '.join(TYPES)}")
    is_obj = kind == ".obj"
    require("export", ("pyvista",))
    if not is_obj:
        require(f"a file {kind}", ("h5py",), "'fem_snh[export]'")
    run = StoredRun(folder)
    make_folder_of(out)
    function, timeout = f"{__name__}.writers:{TYPES[kind]}", _STATE_TIMEOUT * (1 + len(run.states))
    run_elsewhere(function, out, run.pvd, report=report, timeout=timeout)
    return [obj_path(out, number) for number in range(len(run.states))] if is_obj else [out]


def obj_path(out: Path, number: int) -> Path:
    """Return the path of a sequence's file: ``NAME_0001.obj`` for ``NAME.obj`` and number 1."""
    return out.with_name(f"{out.stem}_{number:04}{out.suffix}")
