"""The fields that a scene's key ``fields`` names, as arrays of its output files."""

from __future__ import annotations

from collections.abc import Sequence

from fem_snh._dolfinx import DataArray
from fem_snh.fem.field_values import FieldValues
from fem_snh.fem.problem import Problem
from fem_snh.output_fields import ON_REQUEST


class RequestedFields:
    """The fields of a problem's states for its output files; compiles their kernels. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    names : sequence of str
        Names of fields.
    at : {"cells", "nodes"}
        Their location; ``reaction_force`` is at the nodes always.
    """

    def __init__(self, problem: Problem, names: Sequence[str], at: str) -> None:
        self._problem, self._names, self._at = problem, names, at
        self._values = FieldValues(problem)
        self._values.prepare(names)

    def arrays(self) -> tuple[list[DataArray], list[DataArray]]:
        """Return the arrays at the cells and at the nodes of the present state. Collective."""
        seconds = self._problem.seconds["assemble"]
        found = self._values.evaluate(self._names, self._at)
        self._problem.seconds["assemble"] = seconds  # a reaction is output, not part of the solve
        arrays = [DataArray(name, found[name], ON_REQUEST[name].components) for name in found]
        nodal = [array for array in arrays if self._at == "nodes" or array.name == "reaction_force"]
        return [array for array in arrays if array not in nodal], nodal
