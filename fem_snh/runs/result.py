"""The result of a run: what ``fem_snh.run`` returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.problem.problem import Problem
from fem_snh.records.run_record import Record

if TYPE_CHECKING:
    from fem_snh.accuracy.goal_errors import Estimate
    from fem_snh.runs.output.field_values import FieldValues
    from fem_snh.steps.dynamics.dynamics import Dynamics


@dataclass
class Result:
    """The status, the record and the final state of a run.

    Attributes
    ----------
    converged : bool
        Whether the load reached 1.
    status : str
        "converged", or the load and the reason of the failure.
    record : dict
        The content of run.json.
    problem : Problem
        The discretised problem, in the state of the last load that converged.
    out : Path or None
        The folder of the output; None if nothing is written.
    dynamics : Dynamics or None
        The motion; None in a quasi-static scene.
    estimate : Estimate or None
        The estimated errors of goals, also in each cell; None if the scene asks for none.
    """

    converged: bool
    status: str
    record: Record
    problem: Problem = field(repr=False)
    out: Path | None = None
    dynamics: Dynamics | None = field(default=None, repr=False)
    estimate: Estimate | None = field(default=None, repr=False)

    @property
    def steps(self) -> list[Record]:
        """Return the rows of run.json, one for each attempted load increment."""
        return list(self.record["steps"])

    @property
    def notes(self) -> list[Record]:
        """Return the notes of run.json: what to know beside "converged"."""
        return list(self.record.get("notes", ()))

    @property
    def goals(self) -> dict[str, dict[str, float | None]]:
        """Return the goals of run.json by name: value, error, relative error, corrected value."""
        return dict(self.record.get("goals", {}))

    @property
    def u(self) -> _dolfinx.Function:
        """Return the displacement [length], a dolfinx Function, at the last converged load."""
        return self.problem.u

    @property
    def v(self) -> _dolfinx.Function | None:
        """Return the velocity [m/s] at the last converged time; None in a quasi-static scene."""
        return self.dynamics.v if self.dynamics else None

    @property
    def a(self) -> _dolfinx.Function | None:
        """Return the acceleration [m/s^2] at the last converged time; None if quasi-static."""
        return self.dynamics.a if self.dynamics else None

    def field(self, name: str, at: str = "cells") -> Array:
        """Return a stress, strain or force at the last load that converged. Collective.

        The scene need not name it in ``fields``. The first call compiles its kernels.

        Parameters
        ----------
        name : str
            One of `fem_snh.records.output_fields.ON_REQUEST`, e.g. "von_mises" [Pa].
        at : {"cells", "nodes", "points"}
            "cells": means over this rank's cells, (cells, ...); "nodes": the L2 projection at the
            nodes of ``u``, ghosts included, (nodes, ...), with invariants and principal values of
            the projected tensor; "points": values at the quadrature points, (cells, points, ...).
            ``reaction_force`` is at the nodes always.

        Raises
        ------
        BadInput
            For an unknown name or location.
        """
        return self._fields.evaluate([name], at)[name]

    @cached_property
    def _fields(self) -> FieldValues:
        from fem_snh.runs.output.field_values import FieldValues

        return FieldValues(self.problem)

    @property
    def frequencies(self) -> list[float]:
        """Return the eigenfrequencies [Hz], ascending; empty if the scene requests no modes."""
        return list(self.record.get("modes", {}).get("frequencies", ()))
