"""Print the progress of a run on the terminal: a line for each step, from rank 0."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from fem_snh.errors import in_words
from fem_snh.records.run_record import Record, with_notes
from fem_snh.records.units import volume_change

if TYPE_CHECKING:
    from fem_snh.accuracy.goal_errors import Estimate

#: ANSI codes of the styles (ECMA-48, section 8.3.117). Importing rich, which has them, takes a
#: tenth of a small run.
_STYLES = {"bold": 1, "red": 31, "green": 32, "yellow": 33}
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

    def __init__(self, comm: MPI.Comm, enabled: bool, expected: str | None = None) -> None:
        self._expected = expected
        self._enabled = enabled and comm.rank == 0
        # mpirun gives its processes a terminal even when its output goes to a file.
        self._styled = comm.size == 1 and _shows_styles()

    def line(self, text: str) -> None:
        """Print a line if printing is enabled."""
        if self._enabled:
            print(text, flush=True)

    def _style(self, text: str, style: str) -> str:
        """Return the text in a style of ``_STYLES``, where the terminal shows it."""
        return f"\x1b[{_STYLES[style]}m{text}\x1b[0m" if self._styled else text

    def start(self, record: Record) -> None:
        """Print the scene, the material, the discretisation and the solver."""
        found = record["material"]
        materials = " + ".join(
            f"{m['name']}{equation and f' ({equation})'}, E = {m['E']:g}, nu = {m['nu']:g}"
            for m in (found if isinstance(found, list) else [found])
            for equation in [m.get("equation", "")]
        )
        method = f"{record['hessian']} Hessian"
        if "globalization" in record:
            method += f", {record['globalization']}"
        self.line(
            f"{self._style(record['scene'], 'bold')}: {materials}; "
            f"{record['cells']:,} {record['element']} cells, {record['dofs']:,} dofs; "
            f"{method}; {record['ranks']} rank(s)"
        )
        self._notes(record)
        if self._expected:
            self.line(f"  expected to fail: {self._expected}")

    def _notes(self, record: Record) -> None:
        """Print the notes."""
        for note in record.get("notes", []):
            self.line(f"  {self._style('note', 'yellow')}: {note['text']}")

    def resumed(
        self, load: float, finished: bool, missing: Sequence[str], duration: float | None = None
    ) -> None:
        """Print the load, or the time, from which a resumed run continues.

        If the run is finished, print what of its last state is ``missing``. ``duration`` is the
        time of load 1 [s]; None in a static scene.
        """
        at = f"load {load:.6g}" if duration is None else f"time {load * duration:.6g} s"
        left = f"computing of its last state: {'; '.join(missing)}" if missing else "nothing to do"
        self.line(f"  finished already: {left}" if finished else f"  resumed from {at}")

    def step(self, row: Record) -> None:
        """Print the row of a load or time step."""
        if kinds := row.get("notes"):
            mark = self._style(f"ok, {', '.join(kinds)}", "yellow")
        elif row["converged"]:
            mark = self._style("ok  ", "green")
        else:
            mark = self._style("fail", "yellow" if self._expected else "red")
        at = f"time {row['time']:.4g} s" if "time" in row else f"load {row['load']:.4f}"
        self.line(
            f"  {at} {mark} {row['newton']:3d} Newton "
            f"({row['clamped']} filtered), {row['linear']:6d} linear, {_other_iterations(row)}"
            f"residual {row['residual']:.1e}, "
            f"volume {volume_change(row['volume_ratio'])} %, min J {row['min_J']:.3f}"
            + (f" (cell means {row['min_cell_J']:.3f})" if row["min_J"] <= 0 else "")
            + f", {row['seconds']:.2f} s"
            + ("" if row["converged"] else f"  {row['reason']}, halved")
        )

    def estimating(self, estimate: Estimate) -> None:
        """Print what the estimate of the errors will cost, before it is made."""
        self.line(f"  {estimate.announcement()}")

    def estimated(self, estimate: Estimate) -> None:
        """Print the goals with their errors, or the reason why there is no estimate."""
        for line in estimate.lines():
            self.line(f"  {line}")

    def level(self, lines: Sequence[str]) -> None:
        """Print the lines of `fem_snh.accuracy.levels.Levels.lines`, the first in bold.

        They describe one level of a run to a required accuracy: a head, then a line for each goal.
        """
        for line in lines:
            self.line(self._style(line, "bold") if line is lines[0] else line)

    def reached(self, accuracy: Record, duration: float | None) -> None:
        """Print whether the required accuracy was reached, and what ended the levels.

        ``accuracy`` is the record of the levels. Goals of a dynamic scene are evaluated at its end,
        after ``duration`` [s], or at a named time.
        """
        asked = f"{100 * accuracy['within']:g} %"
        if accuracy["reached"]:
            untouched = ", ".join(accuracy["without_contact"])
            but = f" but {untouched}, without an estimate," if untouched else ""
            small = ", ".join(accuracy["small"])
            of = f", {small} of a tenth of the largest force" if small else ""
            besides = ", beside what the errors do not include" if accuracy["left_out"] else ""
            at: dict[float, list[str]] = {}
            for name, load in accuracy.get("at", {}).items():
                at.setdefault(load, []).append(name)
            unit = "load {:.6g}" if duration is None else "time {:.6g} s"
            places = {load * (duration or 1.0): names for load, names in at.items()}
            loads = "".join(f", {in_words(n)} at {unit.format(x)}" for x, n in places.items())
            loads += "" if duration is None or at else f" at time {duration:.6g} s"
            text = f"every goal{but} is within {asked}{of}{loads}{besides}"
            self.line(self._style(text, "green"))
            return
        best, relative = "no goal has an estimate", accuracy["relative"]
        if relative is not None:
            best = f"{accuracy['worst']} is known to {100 * relative:.2g} %"
            if relative <= accuracy["within"]:
                best = "the bounds are, but finer meshes have another answer"
        elif accuracy["worst"]:
            best = f"the estimate of {accuracy['worst']} has no bound yet"
        ended = f"; {accuracy['limit']}" if accuracy["limit"] else ""
        self.line(self._style(f"not within {asked}: {best}{ended}", "red"))

    def end(self, record: Record, out: Path | None) -> None:
        """Print the frequencies, the status, the files and the notes."""
        files = "run.json, steps.csv, fields.pvd"
        if modes := record.get("modes"):
            listed = ", ".join(f"{f:.4g}" for f in modes["frequencies"][:_FREQUENCIES])
            listed += ", ..." if len(modes["frequencies"]) > _FREQUENCIES else ""
            self.line(f"  frequencies [Hz]: {listed}")
            files += ", modes.csv, modes.pvd"
        where = f"; {out}/{files}" if out else ""
        status = with_notes(record["status"], len(record.get("notes", [])))
        if self._expected:
            outcome = "converged, not as expected" if record["converged"] else "failed as expected"
            status = f"{outcome}: {status}"
        self.line(f"  {status} in {record['seconds']['total']:.1f} s{where}")
        self._notes(record)


def _other_iterations(row: Record) -> str:
    """Return the text of a step's other iterations: L-BFGS, and Newton's for stability; or ""."""
    text = f"{row['lbfgs']} L-BFGS, " if row.get("lbfgs") else ""
    examined = row.get("examined_newton")
    return f"{text}{examined} Newton to examine it, " if examined else text


def _shows_styles() -> bool:
    """Return whether standard output is a terminal whose user has not turned colours off."""
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return sys.stdout.isatty() and not plain
