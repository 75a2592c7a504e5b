"""NaN in the displacement in the middle of a Newton iteration.

``python -m fem_snh.studies.extremes.faults.nan`` is fem-snh with an SNES monitor that does it.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from fem_snh.studies.extremes.faults.trial import Trial, ended, read_record

#: In which step, after which Newton iteration.
_STEP, _ITERATION = 4, 1


def nan_in_u(folder: Path) -> dict[str, Any]:
    """One number of u becomes NaN: the step fails, is halved, and the run goes on."""
    trial = Trial(folder)
    row = ended(trial, trial.wait(trial.start(2, module=__name__)))
    steps = read_record(trial.out).get("steps", [])
    failed = [step for step in steps if not step["converged"]]
    row["status"] = "; ".join([step["reason"] for step in failed] + [str(row["status"])])
    row["holds"] &= failed == [steps[_STEP - 1]] if steps else False
    row["holds"] &= "NaN" in row["status"]
    return row


def _injecting(create: Any) -> Any:
    """``solver.create``, whose SNES is hit once."""

    def created(*arguments: Any, **options: Any) -> Any:
        snes = create(*arguments, **options)
        solves = []

        def monitor(snes: Any, its: int, norm: float) -> None:
            if its == 0:
                solves.append(norm)
            if (len(solves), its) == (_STEP, _ITERATION):
                x = snes.getSolution()
                if x.comm.rank == 0:
                    x.array[x.getLocalSize() // 2] = float("nan")

        snes.setMonitor(monitor)
        return snes

    return created


def main() -> int:
    """The command line of fem-snh."""
    from fem_snh import cli, solver

    solver.create = _injecting(solver.create)
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
