"""The result of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fem_snh.fem.problem import Problem


@dataclass
class Result:
    """What a run computed.

    Attributes
    ----------
    converged : bool
        Whether the load reached 1.
    status : str
        "converged", or where and why the run stopped.
    record : dict
        The content of run.json.
    problem : Problem
        The discretised problem, in the state of the last load that converged.
    out : Path or None
        The folder of the output.
    """

    converged: bool
    status: str
    record: dict[str, Any]
    problem: Problem = field(repr=False)
    out: Path | None = None

    @property
    def steps(self) -> list[dict[str, Any]]:
        """The rows of run.json, one for each attempted load increment."""
        return list(self.record["steps"])

    @property
    def u(self) -> Any:
        """The displacement [length], a dolfinx Function, at the last load that converged."""
        return self.problem.u

    @property
    def frequencies(self) -> list[float]:
        """The eigenfrequencies [Hz] of the scene's table ``modes``, in ascending order."""
        return list(self.record.get("modes", {}).get("frequencies", ()))
