"""All states of a run in one VTKHDF file: a temporal unstructured grid, with the load as its time.

``python -m fem_snh.viewing.export.vtkhdf`` reads {"pvd", "record", "out"} as JSON from standard
input and prints the number of states written and of all. Exit codes: see
`fem_snh.viewing.render.worker`. It is a process of its own because h5py fails to import after
dolfinx, which loads another HDF5 library.

References
----------
Kitware, *VTKHDF format specification*, version 2:
https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/vtkhdf_specifications.html
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
import pyvista as pv

from fem_snh.atomic_files import replace_file
from fem_snh.viewing.render.worker import serve
from fem_snh.viewing.states import ExportedState, States

#: Of the specification; 2.2 is the first that allows groups beside VTKHDF.
VERSION = (2, 2)


def write_vtkhdf(
    out: Path,
    states: States,
    record: dict[str, Any],
    report: Callable[[int, int], None] | None = None,
) -> Path:
    """Write all states into one file and return its path; an earlier file is replaced at the end.

    The mesh is written once, as one part. The fields of the states follow each other in one array
    for each field, of which ``Steps`` holds the offsets. One state at a time is in memory.

    Parameters
    ----------
    out : Path
        The file.
    states : States
        The states.
    record : dict
        The run's run.json; the file holds it as the text ``/fem_snh/run.json``, which VTK ignores.
    report : callable, optional
        Called with the numbers of states written and of all states.

    Raises
    ------
    BadInput
        If a state cannot be read, or the file cannot be written.
    """

    def write(file: BinaryIO) -> None:
        with h5py.File(file, "w") as hdf:
            root = hdf.create_group("VTKHDF")
            root.attrs["Version"] = VERSION
            # The reader expects a string of fixed length.
            root.attrs.create("Type", np.bytes_("UnstructuredGrid"))
            _write_mesh(root, states)
            _write_steps(root, states)
            for number in range(len(states)):
                _write_state(root, states.read(number), number, len(states))
                if report:
                    report(number + 1, len(states))
            hdf.create_dataset("fem_snh/run.json", data=json.dumps(record))

    replace_file(out, write)
    return out


def _write_mesh(root: h5py.Group, states: States) -> None:
    """Write the points [m] and the cells."""
    mesh = states.mesh
    root["NumberOfPoints"] = np.array([mesh.n_points])
    root["NumberOfCells"] = np.array([mesh.n_cells])
    root["NumberOfConnectivityIds"] = np.array([len(mesh.cell_connectivity)])
    root["Points"] = mesh.points
    root["Connectivity"] = np.asarray(mesh.cell_connectivity, dtype=np.int64)
    offsets = pv.convert_array(mesh.GetCells().GetOffsetsArray())
    root["Offsets"] = np.asarray(offsets, dtype=np.int64)
    root["Types"] = np.asarray(mesh.celltypes, dtype=np.uint8)


def _write_steps(root: h5py.Group, states: States) -> None:
    """Write the loads, and that all steps have the one mesh."""
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = len(states)
    steps["Values"] = np.array(states.loads)
    steps["NumberOfParts"] = np.ones(len(states), dtype=np.int64)
    for name in ("PartOffsets", "PointOffsets"):
        steps[name] = np.zeros(len(states), dtype=np.int64)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        steps[name] = np.zeros((len(states), 1), dtype=np.int64)


def _write_state(root: h5py.Group, state: ExportedState, number: int, count: int) -> None:
    """Write the fields of a state; the first one makes the arrays for all."""
    for place, fields in (("PointData", state.point_data), ("CellData", state.cell_data)):
        for name, values in fields.items():
            rows = len(values)
            if number == 0:
                offsets = root.require_group(f"Steps/{place}Offsets")
                offsets[name] = rows * np.arange(count)
                shape = (rows * count, *values.shape[1:])
                root.require_group(place).create_dataset(name, shape, values.dtype)
            root[place][name][rows * number : rows * (number + 1)] = values


def _write(job: dict[str, Any]) -> None:
    """Write the file that a request describes, and print the progress."""
    write_vtkhdf(
        Path(job["out"]),
        States(Path(job["pvd"])),
        job["record"],
        lambda written, count: print(written, count, flush=True),
    )


if __name__ == "__main__":
    serve(_write)
