"""A .pvd file, which lists the states of a run for ParaView, and the names of their files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from fem_snh.errors import BadInput, on_root
from fem_snh.files import open_file, replace_file
from fem_snh.records.run_files import RunFiles


class Collection:
    """The states of a run at increasing times, each in files of its own. Collective.

    A state is listed when its files are complete. The file can therefore be read at any time, also
    after a crash, and another run can continue it.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    path : Path
        The .pvd file.
    until : float, optional
        Keep the states of an existing file up to this time; None keeps none.
    files : RunFiles, optional
        The run's files on rank 0. They list each file before it is written; files of states that
        are not kept are removed if they are listed.

    Attributes
    ----------
    times : list of float
        Times of the states, on every rank.

    Raises
    ------
    BadInput
        On every rank, if an existing file cannot be read.
    """

    def __init__(
        self, comm: Any, path: Path, until: float | None = None, files: RunFiles | None = None
    ) -> None:
        self.comm, self.path, self._files = comm, path, files
        self.times: list[float] = on_root(comm, self._keep, until)
        #: The lines of the states that are listed.
        self._rows: list[str] = []

    def _keep(self, until: float | None) -> list[float]:
        """Return the times of the states that are kept; remove the files of the others."""
        kept = []
        if until is not None and self.path.exists():
            try:
                with open_file(self.path) as file:
                    states = list(ET.parse(file).iter("DataSet"))
                kept = [t for s in states if (t := float(s.attrib["timestep"])) <= until]
            except (OSError, ET.ParseError, KeyError, ValueError) as error:
                raise BadInput(f"{self.path} cannot be read ({error}): remove it") from None
        if self._files:
            numbers = ((name, _state_number(name, self.path.stem)) for name in self._files.names)
            self._files.discard([n for n, k in numbers if k is not None and k >= len(kept)])
        return kept

    def name(self, suffix: str, part: str = "", number: int | None = None) -> str:
        """Return the name of a file of state ``number``, by default of the next one."""
        number = len(self.times) if number is None else number
        return f"{self.path.stem}{part}{number:06}{suffix}"

    def announce(self, *names: str) -> None:
        """List the next state's files as files of the run before they are written. On rank 0."""
        if self._files:
            self._files.add((*names, self.path.name))

    def write_next(self, t: float, content: Iterable[bytes | memoryview]) -> None:
        """Write the next state's .vtu file and list it. On rank 0."""
        name = self.name(".vtu")
        self.announce(name)
        replace_file(self.path.with_name(name), lambda file: file.writelines(content))
        self.list_next(t, ".vtu")

    def list_next(self, t: float, suffix: str) -> None:
        """Add the next state, whose files are complete, to the .pvd file. On rank 0."""
        times = [*self.times, t]
        for number in range(len(self._rows), len(times)):
            name = self.name(suffix, number=number)
            self._rows.append(
                f'    <DataSet timestep="{times[number]:.17g}" part="0" file="{name}" />\n'
            )
        replace_file(
            self.path,
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0">\n  <Collection>\n'
            + "".join(self._rows)
            + "  </Collection>\n</VTKFile>\n",
        )


def _state_number(name: str, stem: str) -> int | None:
    """Return the number of the state that a file belongs to; None for another file."""
    rest = name.removeprefix(stem)
    digits = rest.rpartition("_")[2].partition(".")[0]
    return int(digits) if rest != name and digits.isdigit() else None
