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


def is_loaded(problem: Problem) -> bool:
    """Return whether a load, contact or a prescribed displacement acts, however small. Collective.

    What it moves has relative errors.
    """
    force = problem.x.duplicate()
    constrained = np.zeros(len(force.array_r), bool)
    constrained[problem.dirichlet.dofs] = True
    moved = float(np.abs(problem.x.array_r[constrained]).max(initial=0.0))
    acting = problem.rigid.largest_force(problem.x) if problem.rigid else 0.0
    for term in problem.terms:
        if term is not problem.elastic:
            problem.gradient(problem.x, force, [term])
            acting = max(acting, force.norm())
    force.destroy()
    return acting > 0.0 or problem.comm.allreduce(moved, op=MPI.MAX) > _EPS * problem.length


def is_at_rest(problem: Problem) -> bool:
    """Return whether nothing acts on a body, and its displacements are rounding. Collective."""
    return largest_displacement(problem) <= _AT_REST * problem.length and not is_loaded(problem)
