"""Files for ParaView and PyVista."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from mpi4py import MPI

from dolfinx.io import VTKFile


class Writer:
    """Writes functions of one mesh at increasing times; see `vtk_writer`."""

    def __init__(self, file: Any, comm: MPI.Comm, path: Path) -> None:
        self._file, self._comm, self._path = file, comm, path

    def write(self, functions: Sequence[Any], t: float) -> None:
        """Write functions (Lagrange ones of one degree first, then DG0) at time t. Collective.

        The file can be read from then on, whatever becomes of the process.
        """
        self._file.write_function(list(functions), t)
        self._file.close()  # writes the .pvd, which nothing else does; more can be written after
        if self._comm.rank == 0:
            latest = ET.parse(self._path).findall(".//DataSet")[-1].attrib["file"]
            _drop_repeated_pieces(self._path.parent / latest)


def _drop_repeated_pieces(path: Path) -> None:
    """0.5 lists each piece once a function: readers then see every cell as often."""
    tree = ET.parse(path)
    for grid in tree.getroot():
        seen: set[str] = set()
        for piece in grid.findall("Piece"):
            source = piece.attrib["Source"]
            if source in seen:
                grid.remove(piece)
            seen.add(source)
    tree.write(path)


@contextmanager
def vtk_writer(comm: MPI.Comm, path: str | Path) -> Iterator[Writer]:
    """A .pvd (with .vtu/.pvtu pieces beside it) open for writing. Collective."""
    with VTKFile(comm, str(path), "w") as file:
        yield Writer(file, comm, Path(path))
