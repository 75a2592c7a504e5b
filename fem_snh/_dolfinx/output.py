"""Write files for ParaView and PyVista."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from mpi4py import MPI

from dolfinx.io import VTKFile

from fem_snh._dolfinx.vtu_arrays import DataArray, declare_arrays, insert_arrays
from fem_snh.atomic_files import check_whole, remove, replace_file
from fem_snh.errors import BadInput, on_every, on_root

_END = b"</VTKFile>"


class Series:
    """Functions of one mesh at increasing times: a .pvd, and beside it the pieces of each state.

    dolfinx's VTKFile writes a state under hidden names. Complete files are then renamed, and the
    .pvd lists them last. It can therefore be read at any time, also after a crash, and another run
    can continue it on another number of ranks. Collective.

    Attributes
    ----------
    times : list of float
        Times of the states, on every rank.
    """

    def __init__(self, comm: MPI.Comm, path: Path, until: float | None = None) -> None:
        """Start an empty series, or continue the existing one up to the time ``until``.

        Raises BadInput on every rank if the existing one cannot be read.
        """
        self._comm, self._path = comm, path
        self.times: list[float] = on_root(comm, earlier_states, path, until)

    def write(
        self,
        functions: Sequence[Any],
        t: float,
        cells: Sequence[DataArray] = (),
        points: Sequence[DataArray] = (),
    ) -> None:
        """Append a state. Collective.

        Parameters
        ----------
        functions : sequence of dolfinx Function
            Lagrange functions of one degree first, then those of degree 0.
        t : float
            The time.
        cells, points : sequence of DataArray
            Further values at the cells, and at the nodes of the first function.

        Raises
        ------
        BadInput
            On every rank, if one of them cannot write its file.
        """
        hidden = self._path.with_name(f".{self._path.name}")
        file, complaint = VTKFile(self._comm, str(hidden), "w"), ""
        try:
            file.write_function(list(functions), t)
        except RuntimeError as error:
            complaint = str(error)
        try:
            file.close()
        except RuntimeError:
            pass  # VTKFile could not write its own .pvd, which is not used
        try:
            on_every(self._comm, self._show_piece, hidden, complaint, cells, points)
            on_root(self._comm, self._show_state, hidden, t, cells, points)
        finally:
            self._clean(hidden)
            del file  # the destructor writes the hidden .pvd again, if the disk has room for it
            self._clean(hidden)
        self.times.append(t)

    # --- on one rank -----------------------------------------------------------------------------

    def _show_piece(
        self,
        hidden: Path,
        complaint: str,
        cells: Sequence[DataArray],
        points: Sequence[DataArray],
    ) -> None:
        """Give this rank's piece its final name, with the further arrays."""
        name = f"_p{self._comm.rank}_"
        piece = hidden.with_name(f"{hidden.stem}{name}{0:06}.vtu")
        seen = self._named(name, len(self.times), ".vtu")
        check_whole(piece, seen, _END)
        if complaint:
            raise BadInput(f"cannot write {seen}: {complaint}")
        if cells or points:
            content = insert_arrays(piece.read_bytes(), cells, points)
            replace_file(seen, lambda file: file.writelines(content))
        else:
            os.replace(piece, seen)

    def _show_state(
        self, hidden: Path, t: float, cells: Sequence[DataArray], points: Sequence[DataArray]
    ) -> None:
        """Write the .pvtu, which lists each piece once (0.5: once a function), then the .pvd."""
        number = len(self.times)
        listed = hidden.with_name(f"{hidden.stem}{0:06}.pvtu")
        state = self._named("", number, ".pvtu")
        check_whole(listed, state, _END)
        root = ET.parse(listed).getroot()
        for grid in root:
            for piece in grid.findall("Piece"):
                grid.remove(piece)
            for rank in range(self._comm.size):
                source = self._named(f"_p{rank}_", number, ".vtu").name
                ET.SubElement(grid, "Piece", Source=source)
        declare_arrays(root, cells, points)
        ET.indent(root)
        replace_file(state, ET.tostring(root, encoding="unicode"))
        names = [self._named("", k, ".pvtu").name for k in range(number + 1)]
        replace_file(self._path, collection(zip([*self.times, t], names, strict=True)))

    def _named(self, part: str, number: int, suffix: str) -> Path:
        """Return the final name of a file of state ``number``."""
        return self._path.with_name(f"{self._path.stem}{part}{number:06}{suffix}")

    def _clean(self, hidden: Path) -> None:
        """Remove the files that dolfinx wrote under hidden names and that were not renamed."""
        remove(hidden.with_name(f"{hidden.stem}_p{self._comm.rank}_{0:06}.vtu"))
        if self._comm.rank == 0:
            remove(hidden)
            remove(hidden.with_name(f"{hidden.stem}{0:06}.pvtu"))


def earlier_states(path: Path, until: float | None) -> list[float]:
    """Return the times of a .pvd's states up to ``until``; remove the pieces of others.

    Raises BadInput if the file cannot be read. Not collective.
    """
    kept = []
    if until is not None and path.exists():
        try:
            states = list(ET.parse(path).iter("DataSet"))
            kept = [t for s in states if (t := float(s.attrib["timestep"])) <= until]
        except (OSError, ET.ParseError, KeyError, ValueError) as error:
            raise BadInput(f"{path} cannot be read ({error}): remove it") from None
    for file in path.parent.glob(f"{path.stem}*vtu"):
        number = re.search(r"(\d{6,})\.p?vtu$", file.name)
        if number and int(number[1]) >= len(kept):
            remove(file)
    return kept


def collection(states: Iterable[tuple[float, str]]) -> str:
    """Return the text of a .pvd file that lists the files of states with their times."""
    rows = [
        f'    <DataSet timestep="{time:.17g}" part="0" file="{name}" />\n' for time, name in states
    ]
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0">\n  <Collection>\n'
        + "".join(rows)
        + "  </Collection>\n</VTKFile>\n"
    )
