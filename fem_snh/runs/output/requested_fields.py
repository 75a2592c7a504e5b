"""The fields that a scene's key ``fields`` names, as arrays of its output files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fem_snh._dolfinx import DataArray
from fem_snh.output_fields import AT_OBSTACLES, NAMED, NODAL, ON_REQUEST
from fem_snh.problem.problem import Problem
from fem_snh.runs.output.field_values import FieldValues
from fem_snh.terms.history import FieldTerm


class RequestedFields:
    """The fields of a problem's states for its output files; compiles their kernels. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    names : sequence of str
        Names of fields.
    at : {"cells", "nodes"}
        Their location; those of `fem_snh.output_fields.NODAL` are at the nodes always.
    functions : mapping of str to dolfinx Function
        Fields that are functions on the displacement's space, by name: velocity and acceleration.
    """

    def __init__(
        self, problem: Problem, names: Sequence[str], at: str, functions: Mapping[str, Any]
    ) -> None:
        self._problem, self._names, self._at = problem, names, at
        self._computed = [name for name in names if name in ON_REQUEST]
        self._functions = functions
        self._values = FieldValues(problem)
        self._values.prepare(self._computed)
        self._contact: Any = None
        self._self_contact: Any = None
        if set(names) & set(AT_OBSTACLES):
            kinds = [term.name for term in problem.terms]
            if "obstacle" in kinds:
                from fem_snh.contact.fields import ContactFields

                self._contact = ContactFields(problem.V, problem.terms)
            if "self_contact" in kinds:
                from fem_snh.contact.fields import SelfContactPressure

                term = problem.terms[kinds.index("self_contact")]
                self._self_contact = SelfContactPressure(problem.V, term)

    def arrays(self) -> tuple[list[DataArray], list[DataArray]]:
        """Return the arrays at the cells and at the nodes of the present state. Collective."""
        seconds = self._problem.seconds["assemble"]
        found = self._values.evaluate(self._computed, self._at)
        self._problem.seconds["assemble"] = seconds  # a reaction is output, not part of the solve
        for name in self._names:
            if name in AT_OBSTACLES:
                found[name] = self._at_contact(name)
            elif name in self._functions:
                found[name] = self._functions[name].x.array.reshape(-1, 3).copy()
            elif name not in found:
                found[name] = self._of_terms(name)
        arrays = [DataArray(name, found[name], NAMED[name].components) for name in self._names]
        nodal = [array for array in arrays if self._at == "nodes" or array.name in NODAL]
        return [array for array in arrays if array not in nodal], nodal

    def _of_terms(self, name: str) -> Any:
        """Return a field of terms at the nodes. Collective."""
        u = self._problem.split(self._problem.x)[0]
        terms = [term for term in self._problem.terms if isinstance(term, FieldTerm)]
        return sum(term.nodal_field(name, u) for term in terms)

    def _at_contact(self, name: str) -> Any:
        """Return a field of `fem_snh.output_fields.AT_OBSTACLES`, (local nodes,). Collective."""
        u = self._problem.split(self._problem.x)[0]
        found: Any = self._contact.evaluate(name, u) if self._contact else 0.0
        if self._self_contact and name == "contact_pressure":
            found = found + self._self_contact.evaluate(u)
        return found
