"""The files of a run for ParaView and PyVista: fields.pvd and modes.pvd with their pieces."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from petsc4py import PETSc

from fem_snh import _dolfinx
from fem_snh.fem.modes import Modes
from fem_snh.fem.problem import Problem

if TYPE_CHECKING:
    from fem_snh.runs.requested_fields import RequestedFields


class Fields:
    """The time series fields.pvd, with the load as time. Collective.

    Its fields are the displacement [length] at the nodes; means over each cell of J = det F and of
    the energy density [Pa]; the smallest eigenvalue of the Hessian of the energy density in each
    cell; and, if the pressure is unknown, the pressure [Pa] at the nodes of the displacement.

    Parameters
    ----------
    path : Path
        The .pvd file.
    problem : Problem
        The discretised problem.
    until : float, optional
        For a resumed run: keep the states of an existing file up to this load.
    names : sequence of str, optional
        Further fields, of `fem_snh.output_fields.ON_REQUEST`.
    at : {"cells", "nodes"}
        Where they are written.

    Attributes
    ----------
    jit_seconds : float
        Time spent compiling what the further fields need.
    """

    def __init__(
        self,
        path: Path,
        problem: Problem,
        until: float | None = None,
        names: Sequence[str] = (),
        at: str = "cells",
    ) -> None:
        constant = _dolfinx.function_space(problem.domain, 0, family="DG")
        means = ["J", *(["energy_density"] if problem.has_energy else []), "min_eigenvalue"]
        self._cellwise = {name: _dolfinx.function(constant, name) for name in means}
        self._dofs = _dolfinx.node_dofs(constant)[:, 0]
        self._nodal = [problem.u]
        if problem.saddle_point:
            self._pressure = _dolfinx.function(problem.saddle_point.Q, "pressure")
            scalars = _dolfinx.function_space(problem.domain, problem.element.degree)
            self._nodal.append(_dolfinx.function(scalars, "pressure"))
        self._series = _dolfinx.Series(problem.comm, path, until)
        self._requested: RequestedFields | None = None
        start = perf_counter()
        if names:
            from fem_snh.runs.requested_fields import RequestedFields

            self._requested = RequestedFields(problem, names, at)
        self.jit_seconds = perf_counter() - start

    def write(self, problem: Problem) -> None:
        """Append the problem's state at its load, unless the series has this load. Collective."""
        if problem.load in self._series.times:
            return
        fields = problem.cell_fields(problem.x)
        values = {
            "J": fields["deformed_volume"] / fields["volume"],
            "energy_density": fields["energy"] / fields["volume"],
            "min_eigenvalue": fields["min_eigenvalue"],
        }
        for name, function in self._cellwise.items():
            function.x.array[self._dofs] = values[name]
        if problem.saddle_point:
            self._pressure.x.array[:] = problem.saddle_point.pressure()
            self._nodal[1].interpolate(self._pressure)
        further = self._requested.arrays() if self._requested else ([], [])
        self._series.write([*self._nodal, *self._cellwise.values()], problem.load, *further)


def write_modes(path: Path, modes: Modes) -> None:
    """Write the mode shapes to a .pvd file, at the times 1, 2, ... Collective.

    Each time has the mode shape ``mode`` [length] and the displacement about which the body
    vibrates. The mean square of ``mode`` over the mass is the square of `Problem.length`.

    Parameters
    ----------
    path : Path
        The .pvd file.
    modes : Modes
        The eigenfrequencies and mode shapes.
    """
    problem = modes.problem
    shape = _dolfinx.function(problem.V, "mode")
    series = _dolfinx.Series(problem.comm, path)
    for number, vector in enumerate(modes.shapes, 1):
        x = _dolfinx.petsc_vec(shape)
        vector.copy(x)
        x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        series.write([problem.u, shape], float(number))
