"""A line per step on the terminal, from rank 0."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console


class Progress:
    """Says what is being solved, how each step went, and where the output is."""

    def __init__(self, comm: Any, enabled: bool) -> None:
        self._console = Console(
            quiet=not enabled or comm.rank > 0,
            highlight=False,
            soft_wrap=True,
            # mpirun's own terminal looks like one even when its output goes to a file.
            color_system="auto" if comm.size == 1 else None,
        )

    def start(self, record: dict[str, Any]) -> None:
        m = record["material"]
        self._console.print(
            f"[bold]{record['scene']}[/]: {m['name']}, E = {m['E']:g}, nu = {m['nu']:g}; "
            f"{record['cells']:,} {record['element']} cells, {record['dofs']:,} dofs; "
            f"{record['hessian']} Hessian; {record['ranks']} rank(s)"
        )

    def resumed(self, load: float, finished: bool) -> None:
        self._console.print(
            "  finished already: nothing to do" if finished else f"  resumed from load {load:.6g}"
        )

    def step(self, row: dict[str, Any]) -> None:
        mark = "[green]ok[/]  " if row["converged"] else "[red]fail[/]"
        self._console.print(
            f"  load {row['load']:.4f} {mark} {row['newton']:3d} Newton "
            f"({row['clamped']} filtered), {row['linear']:6d} linear, "
            f"residual {row['residual']:.1e}, "
            f"volume {100 * (row['volume_ratio'] - 1):+.2f} %, min J {row['min_J']:.3f}, "
            f"{row['seconds']:.2f} s" + ("" if row["converged"] else f"  {row['reason']}, halved")
        )

    def end(self, record: dict[str, Any], out: Path | None, unused: list[str]) -> None:
        files = "run.json, steps.csv, fields.pvd"
        if modes := record.get("modes"):
            listed = ", ".join(f"{f:.4g}" for f in modes["frequencies"][:10])
            listed += ", ..." if len(modes["frequencies"]) > 10 else ""
            self._console.print(f"  frequencies [Hz]: {listed}")
            files += ", modes.csv, modes.pvd"
        where = f"; {out}/{files}" if out else ""
        self._console.print(f"  {record['status']} in {record['seconds']['total']:.1f} s{where}")
        if unused:
            self._console.print(
                f"  [yellow]note[/]: nothing used the PETSc option(s) {', '.join(unused)}"
            )
