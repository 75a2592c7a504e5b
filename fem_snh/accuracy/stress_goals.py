r"""Goals of stress: means of von Mises' stress over cells, or around a point.

With the deviator s of the Cauchy stress the goal is

.. math:: Q = \int w \sqrt{3/2\, s : s} \,\mathrm{d}V \Big/ \int w \,\mathrm{d}V

over cells of the body at rest, with w = 1 or, around a point, :math:`w = \exp(-2 d^2/r^2)` at the
distance d (Becker & Rannacher 2001, sec. 3, on such regularised functionals). The pressure has no
part in s, so no volume term is needed, nor a pressure that is an unknown. The largest stress is no
goal: at a corner where it is singular each finer mesh has a larger one; nor is that at a point
alone, which no coarse mesh knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.accuracy.duals import Dual, Linearisation
from fem_snh.accuracy.goals import MOST_RADII, REACH, CellsGoal, derivative_of, sizes_near
from fem_snh.assembly.unknowns import copy_to_function
from fem_snh.errors import BadInput, bad_value
from fem_snh.kernels.ufl_forms import energy_density
from fem_snh.materials.energy import Energy
from fem_snh.materials.parameters import BOUNDS
from fem_snh.materials.volume_split import split
from fem_snh.problem.problem import Problem
from fem_snh.terms.body import displacement_gradient, of_the_body

Array = npt.NDArray[Any]

#: Quadrature degree, the same in both elements: a state has one stress.
_DEGREE = 6
#: Stress below which its root is smooth, in E: at zero it has no derivative.
_ZERO = 1e-12


class StressGoal(CellsGoal):
    """The mean of von Mises' stress [Pa]. Parameters are those of `CellsGoal`."""

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`. Raises BadInput in plane stress, and for a material without energy."""
        self._check(problem)
        whole, size = map(_dolfinx.form, self._integrals(problem))
        volume = _dolfinx.assemble_scalar(size)

        def values() -> list[float]:
            problem.split(problem.x)
            return [float(problem.modulus * _dolfinx.assemble_scalar(whole) / volume)]

        return values

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`. A root is far from linear: the derivative is that halfway to the run."""
        whole, size = self._integrals(at.problem)
        derivative = derivative_of(at.problem, whole, at.problem.x - 0.5 * at.step)
        derivative.scale(at.problem.modulus / _dolfinx.assemble_scalar(_dolfinx.form(size)))
        return at.dual_of(derivative)

    def _check(self, problem: Problem) -> None:
        """Raise BadInput where the stress is no function of the displacement that UFL derives."""
        key, name = "accuracy.goals", self.names[0]
        lattice = any(region.fractions is not None for region in problem.regions)
        if problem.kinematics.plane_stress or lattice or not problem.regions:
            accepted = "a body with a material, neither a lattice nor in plane stress"
            raise bad_value(key, name, accepted)
        for material in (region.material for region in problem.regions):
            if not material.has_energy:
                accepted = f"a material with an energy, not '{material.name}'"
                raise bad_value(key, name, accepted)

    def _weight(self, domain: Any) -> tuple[Any, int]:
        """Return the weight of the mean in UFL, and the degree of its quadrature."""
        return _dolfinx.constant(domain, 1.0), _DEGREE

    def _integrals(self, problem: Problem, other: Any = None) -> tuple[Any, Any]:
        """Return the forms of the integral of the stress over E, and of the weight.

        With another displacement ``other``, that of the size of their difference.
        """
        domain, kinematics = problem.domain, problem.kinematics
        weight, degree = self._weight(domain)
        every = np.arange(_dolfinx.num_owned(domain), dtype=np.int32)
        parts = [np.intersect1d(region.cells, every[self._cells]) for region in problem.regions]
        parts.append(np.setdiff1d(every, np.concatenate(parts)))
        measures = _dolfinx.cell_measures(domain, parts, problem.element.cell, degree)
        measures = [of_the_body(kinematics, domain, dx) for dx in measures[:-1]]
        energies = [region.material.expression for region in problem.regions]

        def stresses_of(u: Any) -> list[Any]:
            F = ufl.variable(ufl.Identity(3) + displacement_gradient(u, kinematics))
            return [_von_mises(energy, F, problem.modulus) for energy in energies]

        stresses = stresses_of(problem.u)
        if other is not None:
            pairs = zip(stresses, stresses_of(other), strict=True)
            stresses = [abs(stress - before) for stress, before in pairs]
        whole = sum(weight * sigma * dx for sigma, dx in zip(stresses, measures, strict=True))
        return whole, sum(weight * dx for dx in measures)


class PointStressGoal(StressGoal):
    """The mean of von Mises' stress [Pa] around a point of the body at rest.

    Parameters
    ----------
    name : str
        Its name.
    point : (3,) sequence of float
        Reference coordinates [m].
    radius : float
        The distance r [m] at which the weight is 0.14 of that at the point.
    domain : dolfinx Mesh
        The mesh of the body.

    Raises
    ------
    BadInput
        On every rank, for cells that are much larger than the radius, or far away. Collective.
    """

    def __init__(self, name: str, point: Sequence[float], radius: float, domain: Any) -> None:
        dim = domain.topology.dim
        place = np.asarray(point, dtype=float)[:dim]
        X = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)][..., :dim]
        sizes = sizes_near(X, place, radius)
        super().__init__(name, np.flatnonzero(sizes[: _dolfinx.num_owned(domain)]))
        size = domain.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
        if size == 0:
            shown = ", ".join(f"{x:g}" for x in place)
            raise bad_value("point", f"({shown})", f"a point within {REACH:g} radii of the body")
        if size > MOST_RADII * radius:
            accepted = (
                f"at least {size / MOST_RADII:.3g}, as cells have a size of {size:.3g} there, "
                "or a mesh with smaller ones there"
            )
            raise bad_value("radius", f"{radius:g}", accepted)
        self._place, self._radius = place, radius
        self._degree = _DEGREE + 4 * ceil(size / radius)

    def size_of_change(self, problem: Problem, start: PETSc.Vec) -> float:
        """Return the mean of the size of what the stress changed by from a state [Pa]. Collective.

        It has no sign: the change of the mean may be small by chance.
        """
        before = _dolfinx.function(problem.V, "before")
        copy_to_function(problem.split(start)[0], before)
        whole, size = map(_dolfinx.form, self._integrals(problem, before))
        problem.split(problem.x)
        change, volume = map(_dolfinx.assemble_scalar, (whole, size))
        return float(problem.modulus * change / volume)

    def _weight(self, domain: Any) -> tuple[Any, int]:
        """See `StressGoal`."""
        x = _dolfinx.coordinates(domain)
        squared = sum((x[i] - float(c)) ** 2 for i, c in enumerate(self._place))
        return ufl.exp(-2 * squared / self._radius**2), self._degree


def _von_mises(energy: Energy, F: Any, modulus: float) -> Any:
    """Return von Mises' stress over a modulus."""
    try:
        energy = split(energy, BOUNDS["mean"]).deviatoric
    except BadInput:  # no volume term of its own: all of the energy
        pass
    s = ufl.dev(ufl.diff(energy_density(energy, F), F) * F.T / (modulus * ufl.det(F)))
    return ufl.sqrt(1.5 * ufl.inner(s, s) + _ZERO**2)
