r"""How many times too stiff an element is that locks: one linear solve in an element that does not.

The state of the run is the first guess in the mixed form of the other element, with the pressures
zero. One Newton step s from there, of the residual r, leads to a stationary point of the quadratic
model, whose energy is :math:`\Pi_1 = \Pi_0 + r \cdot s / 2`. With elastic energies W, the factor

.. math:: 1 + \frac{\Pi_h - \Pi_1}{\min(W_h, W_1)}

is the ratio of the forces where displacements are prescribed, and the ratio of the displacements
where forces are. It is exact for small strains, and the step needs no line search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import isfinite

from fem_snh import solver
from fem_snh.accuracy.state_notes import REPLACEMENTS
from fem_snh.assembly.elements import Element, element, with_cell_pressures
from fem_snh.errors import BadInput
from fem_snh.problem.problem import Problem

#: Prefix of its solver's options: those of the run are for another problem.
_PREFIX = f"{solver.PREFIX}locking_"
#: Largest number of unknowns for which the other element is solved: about the memory and the time
#: of a run of a few hundred thousand unknowns.
_MAX_DOFS = 400_000
#: Factors between this and 1 are 1, within the error of the quadratic model; below, it is useless.
_LEAST = 0.9
#: Unknowns of degree 2 over those of degree 1 on the same tetrahedra.
_GROWTH = 8


def stiffness_factor(problem: Problem, make: Callable[[Element], Problem]) -> float | None:
    """Return how many times stiffer than its replacement the problem's element is. Collective.

    None for a large problem, for terms that keep a history, for materials that mixed forms do not
    support, and where the state is too far from the other one's for one linear solve.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    make : callable
        Returns the same problem on the same mesh with another element.
    """
    other = element(REPLACEMENTS[problem.element.name], kinematics=problem.kinematics)
    if other.volume == "mean":
        other = with_cell_pressures(other)
    elif len(problem.regions) > 1:  # its continuous pressure is wrong at interfaces
        other = replace(with_cell_pressures(other), pressure_degree=0)
    dofs = problem.dofs * (_GROWTH if other.degree > problem.element.degree else 1)
    if dofs > _MAX_DOFS or problem.history.by_name or not problem.has_energy:
        return None
    if problem.operator != problem.A:  # a cavity's matrix of rank one has no unknown pressure
        return None
    try:
        mixed = make(other)
    except BadInput:  # a material without a volume term, or without a conjugate of it
        return None
    mixed.interpolate(problem)
    x = mixed.x
    energy, elastic = energies(problem)
    start, gradient, external = x.copy(), x.duplicate(), x.duplicate()
    first_energy, first_elastic = energies(mixed)
    mixed.residual(x, gradient)
    mixed.gradient(x, external, mixed.terms[1:])
    mixed.project(external.array)
    snes = solver.create(mixed, prefix=_PREFIX)
    try:
        with solver.callback_errors():
            converged = solver.SemiImplicit(mixed, snes).solve().converged
    finally:
        solver.destroy(snes)
    step = x - start
    change = gradient.dot(step) / 2
    other_energy = first_energy + change
    other_elastic = first_elastic + change - external.dot(step)
    least = min(elastic, other_elastic)
    if not (converged and isfinite(other_energy) and least > 0):
        return None
    factor = 1 + (energy - other_energy) / least
    return max(1.0, factor) if factor > _LEAST else None


def energies(problem: Problem) -> tuple[float, float]:
    """Return the energies of all terms and of the material [J], less those at rest. Collective."""
    at_rest = problem.x.duplicate()
    at_rest.set(0.0)
    rest = problem.elastic.energy(*problem.split(at_rest))
    energy = problem.energy(problem.x)
    return energy - rest, problem.elastic.energy(*problem.split(problem.x)) - rest
