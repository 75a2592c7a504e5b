"""Whether a body is at rest: nothing acts on it, and what moved is rounding."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from fem_snh.problem.problem import Problem

#: Displacements below this part of the body's length are rounding where nothing acts: those of a
#: crushed cube that has returned to rest are 1e-14 to 1e-10.
_AT_REST = 1e-9
#: The rounding error of a position, over the length of the body.
_EPS = float(np.finfo(float).eps)


def largest_displacement(problem: Problem) -> float:
    """Return the largest norm of a nodal displacement [m]. Collective."""
    norms = np.linalg.norm(problem.nodal(problem.x), axis=1)
    return float(problem.comm.allreduce(norms.max(initial=0.0), op=MPI.MAX))


def forces_act(problem: Problem) -> bool:
    """Return whether a load or contact acts, however small. Collective.

    Springs, and an energy in UFL, which may be the body's own, act if their forces are more than
    rounding.
    """
    acts = False
    for term, norm, rounded in problem.force_norms(problem.x):
        if term is not problem.elastic:
            acts |= norm > (problem.rounding_force(problem.x) if rounded else 0.0)
    return acts


def is_at_rest(problem: Problem) -> bool:
    """Return whether nothing acts on a body, and its displacements are rounding. Collective.

    A load, contact or a prescribed displacement acts, however small it is: what it moves has
    relative errors.
    """
    if largest_displacement(problem) > _AT_REST * problem.length or forces_act(problem):
        return False
    moved = float(np.abs(problem.x.array_r[problem.dirichlet.dofs]).max(initial=0.0))
    return bool(problem.comm.allreduce(moved, op=MPI.MAX) <= _EPS * problem.length)
