"""Energies and momenta of a body in motion, and the work of its loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.ghosted_vectors import local_values, writable_values
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.problem.problem import Problem
from fem_snh.terms.history import WorkingTerm
from fem_snh.terms.term import Term

Array = npt.NDArray[Any]


def motion_measures(
    problem: Problem, mass: NodalMass, v: Array, excluded: Sequence[Term]
) -> dict[str, Any]:
    """Return energies and momenta of a problem's present state. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    mass : NodalMass
        The mass matrix.
    v : (local dofs,)
        The velocity [m/s], with ghosts.
    excluded : sequence of Term
        Terms whose energy is no part of the potential energy: those of the time integrator.

    Returns
    -------
    dict
        "kinetic", "elastic" (None for a material without an energy) and "potential" (the sum of all
        other terms that have an energy) [J]; "momentum" [kg m/s] and "angular_momentum" about the
        origin [kg m^2/s], lists of three components. In a plane they
        are per thickness; of a body of revolution only those along the axis are not zero.
    """
    u, p = problem.split(problem.x)
    kinematics = problem.kinematics
    momenta = kinematics.padded(mass.apply(v))
    x = problem.V.tabulate_dof_coordinates() + kinematics.padded(local_values(u))
    local = np.array([kinematics.total(vectors) for vectors in (momenta, np.cross(x, momenta))])
    momentum, angular_momentum = problem.comm.allreduce(local)
    loads = [t for t in _loads(problem, excluded) if t.has_energy]
    return {
        "kinetic": mass.dot(v, v) / 2,
        "elastic": problem.elastic.energy(u, p) if problem.elastic.has_energy else None,
        "potential": sum(term.energy(u, p) for term in loads),
        "momentum": momentum.tolist(),
        "angular_momentum": angular_momentum.tolist(),
    }


def total_energy(measures: Mapping[str, Any]) -> float:
    """Return the sum of kinetic, elastic and potential energy [J]."""
    return float(sum(measures[name] for name in ("kinetic", "elastic", "potential")))


def work_of_loads(
    problem: Problem, u: Array, load: float, end_weight: float, excluded: Sequence[Term]
) -> tuple[float, float]:
    r"""Return the work of changing loads in a step, and what they dissipated [J]. Collective.

    With E(u, t) the energy of the terms that depend on the load, and s = ``end_weight``,

    .. math:: s [E(u_0, t_1) - E(u_0, t_0)] + (1 - s) [E(u_1, t_1) - E(u_1, t_0)] .

    A `WorkingTerm` measures work and dissipation itself: the energy of a stiff obstacle that moves
    while the body does not is far above the work of the forces that it exerts.

    Parameters
    ----------
    problem : Problem
        The problem at the step's end.
    u, load : (local dofs,), float
        Displacement and load at its start.
    end_weight : float
        Weight of the forces at the step's end in the work that they do.
    excluded : sequence of Term
        As for `motion_measures`.
    """
    loads = [t for t in _loads(problem, excluded) if t.has_energy and t.depends_on_load]
    loads = [t for t in loads if not isinstance(t, WorkingTerm)]
    work, dissipated = problem.history.step_work(problem.split(problem.x)[0], end_weight)
    if not loads:
        return work, dissipated
    before, (after, p) = _dolfinx.create_vector(problem.V), problem.split(problem.x)
    writable_values(before)[:] = u
    for sign, at in ((1, problem.load), (-1, load)):
        problem.dirichlet.set_load(at)  # a program's constants
        for term in loads:
            term.set_load(at)
            work += sign * end_weight * term.energy(before, p)
            if end_weight < 1:
                work += sign * (1 - end_weight) * term.energy(after, p)
    problem.dirichlet.set_load(problem.load)
    for term in loads:
        term.set_load(problem.load)
    return work, dissipated


def _loads(problem: Problem, excluded: Sequence[Term]) -> list[Term]:
    """Return the terms beside the elastic energy and those that are excluded."""
    return [t for t in problem.terms if t is not problem.elastic and t not in excluded]
