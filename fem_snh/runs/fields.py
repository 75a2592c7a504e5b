"""What ParaView and PyVista read of a run: fields.pvd and modes.pvd with their pieces."""

from __future__ import annotations

from pathlib import Path

from petsc4py import PETSc

from fem_snh import _dolfinx
from fem_snh.fem.modes import Modes
from fem_snh.fem.problem import Problem


class Fields:
    """Writes displacement, J, energy density and smallest eigenvalue to a .pvd. Collective.

    And the pressure [Pa], if it is unknown, at the nodes of the displacement. With ``until`` it
    goes on with what is there up to this load.
    """

    def __init__(self, path: Path, problem: Problem, until: float | None = None) -> None:
        constant = _dolfinx.function_space(problem.mesh.domain, 0, family="DG")
        names = ["J", *(["energy_density"] if problem.has_energy else []), "min_eigenvalue"]
        self._cellwise = {name: _dolfinx.function(constant, name) for name in names}
        self._dofs = _dolfinx.node_dofs(constant)[:, 0]
        self._nodal = [problem.u]
        if problem.saddle_point:
            self._pressure = _dolfinx.function(problem.saddle_point.Q, "pressure")
            scalars = _dolfinx.function_space(problem.mesh.domain, problem.element.degree)
            self._nodal.append(_dolfinx.function(scalars, "pressure"))
        self._series = _dolfinx.Series(problem.comm, path, until)

    def write(self, problem: Problem) -> None:
        """Append the present state, at time = load, unless it is there.

        J and energy are means over each cell.
        """
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
        self._series.write([*self._nodal, *self._cellwise.values()], problem.load)


def write_modes(path: Path, modes: Modes) -> None:
    """Write the shapes to a .pvd, at times 1, 2, ..., each with the state it is about. Collective.

    ``mode`` [m] is scaled so that its mean square over the body's mass is ``length`` squared.
    """
    problem = modes.problem
    shape = _dolfinx.function(problem.V, "mode")
    series = _dolfinx.Series(problem.comm, path)
    for number, vector in enumerate(modes.shapes, 1):
        x = _dolfinx.petsc_vec(shape)
        vector.copy(x)
        x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        series.write([problem.u, shape], float(number))
