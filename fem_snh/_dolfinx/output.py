"""Write files for ParaView and PyVista."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from dolfinx.io import VTKFile

from fem_snh._dolfinx.vtu_arrays import DataArray, declare_arrays, insert_arrays
from fem_snh.atomic_files import check_whole, remove, replace_file
from fem_snh.errors import BadInput, on_every, on_root
from fem_snh.pvd import Collection

_END = b"</VTKFile>"


class Series(Collection):
    """Functions of one mesh at increasing times: a .pvd, and beside it the pieces of each state.

    dolfinx's VTKFile writes a state under hidden names, and complete files are then renamed.
    Another run can continue the series on another number of ranks. Collective.
    """

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
        comm, hidden = self.comm, self.path.with_name(f".{self.path.name}")
        on_root(comm, self.announce, self.name(".pvtu"), *map(self._piece, range(comm.size)))
        file, complaint = VTKFile(comm, str(hidden), "w"), ""
        try:
            file.write_function(list(functions), t)
        except RuntimeError as error:
            complaint = str(error)
        try:
            file.close()
        except RuntimeError:
            pass  # VTKFile could not write its own .pvd, which is not used
        try:
            on_every(comm, self._show_piece, hidden, complaint, cells, points)
            on_root(comm, self._show_state, hidden, t, cells, points)
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
        piece = hidden.with_name(f"{hidden.stem}_p{self.comm.rank}_{0:06}.vtu")
        seen = self.path.with_name(self._piece(self.comm.rank))
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
        listed = hidden.with_name(f"{hidden.stem}{0:06}.pvtu")
        state = self.path.with_name(self.name(".pvtu"))
        check_whole(listed, state, _END)
        root = ET.parse(listed).getroot()
        for grid in root:
            for piece in grid.findall("Piece"):
                grid.remove(piece)
            for rank in range(self.comm.size):
                ET.SubElement(grid, "Piece", Source=self._piece(rank))
        declare_arrays(root, cells, points)
        ET.indent(root)
        replace_file(state, ET.tostring(root, encoding="unicode"))
        self.list_next(t, ".pvtu")

    def _piece(self, rank: int) -> str:
        """Return the name of a rank's piece of the next state."""
        return self.name(".vtu", f"_p{rank}_")

    def _clean(self, hidden: Path) -> None:
        """Remove the files that dolfinx wrote under hidden names and that were not renamed."""
        remove(hidden.with_name(f"{hidden.stem}_p{self.comm.rank}_{0:06}.vtu"))
        if self.comm.rank == 0:
            remove(hidden)
            remove(hidden.with_name(f"{hidden.stem}{0:06}.pvtu"))
