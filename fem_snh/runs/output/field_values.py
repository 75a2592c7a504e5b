"""The values of output fields at the state of a problem: at points, cells or nodes.

`FieldValues` evaluates fields; `RequestedFields` makes the output arrays of a scene's ``fields``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_snh.arrays import Array
from fem_snh.assembly.unknowns import with_ghosts
from fem_snh.cache import untimed
from fem_snh.errors import choose
from fem_snh.problem.problem import Problem
from fem_snh.records.output_fields import LOCATIONS, NAMED, NODAL, ON_REQUEST
from fem_snh.runs.output.point_fields import POINT_FIELDS
from fem_snh.runs.output.stress_fields import StressFields
from fem_snh.runs.output.vtu import DataArray

if TYPE_CHECKING:
    from fem_snh.runs.output.nodal_projection import NodalProjection

#: The symmetric tensors of ``POINT_FIELDS``.
_SYMMETRIC = ("cauchy_stress", "green_lagrange_strain")
#: The fields that are functions of the Cauchy stress, and of the displacement gradient.
_OF_STRESS = ("von_mises", "principal_stresses", "hydrostatic_stress")
_OF_GRADIENT = ("principal_stretches",)


class FieldValues:
    """Evaluates the fields of `fem_snh.records.output_fields.ON_REQUEST`. Collective.

    Kernels are compiled when a field is first evaluated that needs them, or by `prepare`.

    Parameters
    ----------
    problem : Problem
        The problem, whose vector ``x`` is the state.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._projection: NodalProjection | None = None

    def prepare(self, names: Sequence[str]) -> None:
        """Compile the kernels that these fields need. Collective."""
        if set(names) & set(POINT_FIELDS):
            _ = self._stresses

    def evaluate(self, names: Sequence[str], at: str = LOCATIONS[0]) -> dict[str, Array]:
        """Return the values of fields by name. Collective.

        Parameters
        ----------
        names : sequence of str
            Names of fields.
        at : {"cells", "nodes", "points"}
            "cells": means over the reference volume of this rank's cells, (cells, ...); "nodes":
            the L2 projection at the displacement's nodes, ghosts included, (nodes, ...); "points":
            values at the quadrature points, (cells, points, ...). At the nodes, invariants and
            principal values are those of the projected tensor. ``reaction_force`` is at the nodes
            always.

        Raises
        ------
        BadInput
            For an unknown name or location.
        """
        for name in names:
            choose("field", name, ON_REQUEST)
        choose("at", at, (*LOCATIONS, "points"))
        wanted = [name for name in names if name in POINT_FIELDS]
        found = {}
        if wanted and at == "nodes":
            found = self._projected(wanted)
        elif wanted:
            state = self._stresses.evaluate(self._problem.x, wanted)
            found = {name: state.mean(name) for name in wanted} if at == "cells" else state.values
        if "reaction_force" in names:
            found["reaction_force"] = self._reaction_force()
        return {name: found[name] for name in names}

    @cached_property
    def _stresses(self) -> StressFields:
        return StressFields(self._problem)

    def _projected(self, names: Sequence[str]) -> dict[str, Array]:
        """Return fields of ``POINT_FIELDS`` at the nodes, (nodes, ...). Collective.

        Invariants and principal values are those of projected tensors: projected eigenvalues would
        be the eigenvalues of no tensor.
        """
        of_stress = [name for name in names if name in _OF_STRESS]
        of_gradient = [name for name in names if name in _OF_GRADIENT]
        tensors = {*names, "cauchy_stress"} if of_stress else {*names}
        tensors -= {*of_stress, *of_gradient}
        state = self._stresses.evaluate(self._problem.x, sorted(tensors))
        if self._projection is None:
            from fem_snh.runs.output.nodal_projection import NodalProjection  # imports scipy

            self._projection = NodalProjection(self._problem, state.weights)
        gradient = {"gradient": state.H} if of_gradient else {}
        found = self._projection.project(state.values | gradient, _SYMMETRIC)
        if of_stress:
            # With F = I the Cauchy stress is the first Piola-Kirchhoff stress.
            sigma = found["cauchy_stress"][:, None]
            found |= self._at_points(np.zeros_like(sigma), sigma, of_stress)
        if of_gradient:
            H = found["gradient"][:, None]
            found |= self._at_points(H, np.zeros_like(H), of_gradient)
        return found

    def _at_points(self, H: Array, P: Array, names: Sequence[str]) -> dict[str, Array]:
        """Return fields (n, ...) of displacement gradients H and stresses P, (n, 1, 3, 3)."""
        found = self._stresses.loops.evaluate(H, P, names)
        return {name: values[:, 0] for name, values in found.items()}

    def _reaction_force(self) -> Array:
        """Return the force of the constraints [N], (nodes, 3), ghosts included. Collective.

        It is dE/du in constrained directions and 0 in free ones.
        """
        problem = self._problem
        r = problem.gradient_at(problem.x)
        free = r.copy()
        problem.project(free.array)
        force = (r - free).array_r[: problem.owned_displacements]
        return problem.kinematics.padded(with_ghosts(problem.V, force))


class RequestedFields:
    """The fields of a problem's states for its output files; compiles their kernels. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    names : sequence of str
        Names of fields.
    at : {"cells", "nodes"}
        Location of the fields; `fem_snh.records.output_fields.NODAL` are at the nodes always.
    functions : mapping of str to dolfinx Function
        Functions on the displacement's space by the name of their field: velocity, acceleration.
    """

    def __init__(
        self, problem: Problem, names: Sequence[str], at: str, functions: Mapping[str, Any]
    ) -> None:
        self._problem, self._names, self._at = problem, names, at
        self._computed = [name for name in names if name in ON_REQUEST]
        self._functions = functions
        self._values = FieldValues(problem)
        self._values.prepare(self._computed)

    def arrays(self) -> tuple[list[DataArray], list[DataArray]]:
        """Return two lists of the present state's arrays: at the cells, at the nodes. Collective.

        Arrays at the nodes include ghosts.
        """
        with untimed(self._problem):
            found = self._values.evaluate(self._computed, self._at)
        for name in self._names:
            if name in self._functions:
                values = self._functions[name].x.array.copy()
                found[name] = self._problem.kinematics.padded(values)
            elif name not in found:
                found[name] = self._of_terms(name)
        arrays = [DataArray(name, found[name], NAMED[name].components) for name in self._names]
        nodal = [array for array in arrays if self._at == "nodes" or array.name in NODAL]
        return [array for array in arrays if array not in nodal], nodal

    def _of_terms(self, name: str) -> Any:
        """Return the sum of the terms' values of a nodal field, (nodes, ...). Collective."""
        u = self._problem.split(self._problem.x)[0]
        return sum(term.nodal_field(name, u) for term in self._problem.terms)
