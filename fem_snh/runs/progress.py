"""Print the progress of a run on the terminal: a line for each step, from rank 0."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console

#: Largest number of frequencies in the last line; modes.csv has them all.
_FREQUENCIES = 10


class Progress:
    """The printer of the scene, of each step's outcome and of the output's location.

    Parameters
    ----------
    comm : MPI.Comm
        Only its rank 0 prints.
    enabled : bool
        Whether anything is printed.
    expected : str, optional
        The reason of an expected failure. It is printed first; the failure is then no error.
    """

    def __init__(self, comm: Any, enabled: bool, expected: str | None = None) -> None:
        self._expected = expected
        self._console = Console(
            quiet=not enabled or comm.rank > 0,
            highlight=False,
            soft_wrap=True,
            # mpirun gives its processes a terminal even when its output goes to a file.
            color_system="auto" if comm.size == 1 else None,
        )

    def start(self, record: dict[str, Any]) -> None:
        """Print the scene, the material, the discretisation and the solver."""
        found = record["material"]
        materials = " + ".join(
            f"{m['name']}, E = {m['E']:g}, nu = {m['nu']:g}"
            for m in (found if isinstance(found, list) else [found])
        )
        method = f"{record['hessian']} Hessian"
        if "globalization" in record:
            method += f", {record['globalization']}"
        self._console.print(
            f"[bold]{record['scene']}[/]: {materials}; "
            f"{record['cells']:,} {record['element']} cells, {record['dofs']:,} dofs; "
            f"{method}; {record['ranks']} rank(s)"
        )
        for note in record.get("notes", []):
            self._console.print(f"  [yellow]note[/]: {note}")
        if self._expected:
            self._console.print(f"  expected to fail: {self._expected}")

    def resumed(self, load: float, finished: bool, duration: float | None = None) -> None:
        """Print the load, or the time, from which a resumed run continues."""
        at = f"load {load:.6g}" if duration is None else f"time {load * duration:.6g} s"
        self._console.print(
            "  finished already: nothing to do" if finished else f"  resumed from {at}"
        )

    def step(self, row: dict[str, Any]) -> None:
        """Print a load step."""
        colour = "yellow" if self._expected else "red"
        mark = "[green]ok[/]  " if row["converged"] else f"[{colour}]fail[/]"
        at = f"time {row['time']:.4g} s" if "time" in row else f"load {row['load']:.4f}"
        self._console.print(
            f"  {at} {mark} {row['newton']:3d} Newton "
            f"({row['clamped']} filtered), {row['linear']:6d} linear, "
            f"residual {row['residual']:.1e}, "
            f"volume {100 * (row['volume_ratio'] - 1):+.2f} %, min J {row['min_J']:.3f}, "
            f"{row['seconds']:.2f} s" + ("" if row["converged"] else f"  {row['reason']}, halved")
        )

    def end(self, record: dict[str, Any], out: Path | None, unused: list[str]) -> None:
        """Print the frequencies, the status, the files, and PETSc options that nothing used."""
        files = "run.json, steps.csv, fields.pvd"
        if modes := record.get("modes"):
            listed = ", ".join(f"{f:.4g}" for f in modes["frequencies"][:_FREQUENCIES])
            listed += ", ..." if len(modes["frequencies"]) > _FREQUENCIES else ""
            self._console.print(f"  frequencies [Hz]: {listed}")
            files += ", modes.csv, modes.pvd"
        where = f"; {out}/{files}" if out else ""
        status = record["status"]
        if self._expected:
            outcome = "converged, not as expected" if record["converged"] else "failed as expected"
            status = f"{outcome}: {status}"
        self._console.print(f"  {status} in {record['seconds']['total']:.1f} s{where}")
        if unused:
            self._console.print(
                f"  [yellow]note[/]: nothing used the PETSc option(s) {', '.join(unused)}"
            )
