r"""Whether a state is at rest, inverted at quadrature points, or locks.

The pressure of a nearly incompressible body oscillates where it locks. An element with the volume
term at every quadrature point has the pressure :math:`p = \lambda (J - 1)` there. Where it can only
deform with a change of volume, J - 1 changes from point to point or from cell to cell, and p by
:math:`\lambda/\mu` times as much as the shear stress. The indicator is

.. math::

    \rho = \frac{\lambda\, \lVert J - \Pi J \rVert}{2 \mu\, \lVert \operatorname{dev} E \rVert},

with the L2 norms over a material's cells, E the Green-Lagrange strain, and :math:`\Pi J` the
continuous function of degree 1 whose nodal values are the means of J weighted with the nodes' basis
functions. It is zero for homogeneous states and of the order of the cell size where the pressure
is resolved, whatever :math:`\nu` is (docs/theory/locking.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.assembly.cell_loops import PointVolumes, cell_centres, point_volumes
from fem_snh.assembly.unknowns import local_values, summed_over_cells
from fem_snh.problem.problem import Problem
from fem_snh.terms.elastic import Part

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


def inverted_points(problem: Problem) -> tuple[dict[str, Any], int, int]:
    """Return the inverted points of the problem's state, on all ranks. Collective.

    Returns
    -------
    dict
        ``points`` with J <= 0, and ``cells`` that have one; ``min_J``, the smallest J, and the
        ``position`` of the centre of its cell in the reference configuration [m].
    int, int
        The number of all points, and of the material that fills the cell.
    """
    u = local_values(problem.split(problem.x)[0])
    counts, worst = np.zeros(3, dtype=np.int64), (np.inf, [0.0] * 3, 0)
    for number, part in enumerate(problem.elastic.parts):
        J = 1 + point_volumes(part.loops.tables, u).growth
        inverted = J <= 0
        counts += [inverted.sum(), inverted.any(axis=1).sum(), J.size]
        if J.size and J.min() < worst[0]:
            cell = np.unravel_index(J.argmin(), J.shape)[0]
            centre = cell_centres(part.loops.tables, np.array([cell]))[0].tolist()
            worst = (float(J.min()), centre, number)
    points, cells, of = (int(n) for n in problem.comm.allreduce(counts))
    min_J, position, material = min(problem.comm.allgather(worst))
    found = {"points": points, "cells": cells, "min_J": min_J, "position": position}
    return found, of, material


#: Ratio lambda/mu from which an element can lock: nu = 0.4. For what is below, elements of mean
#: dilatation keep the volume term at the points too (`fem_snh.materials.volume_split`).
_LEAST_RATIO = 4.0
#: Force of the mean strain over the residual below which the state is rounding, as after a return
#: to rest.
_RESOLVED = 100.0
#: Part of the whole strain below which its deviator is rounding: a uniform change of volume.
_ROUNDING = 1e-3


def may_lock(problem: Problem) -> list[Part]:
    """Return the materials that can lock: nearly incompressible, with a pointwise volume term.

    In plane stress none does: the thickness changes with the area.
    """
    if problem.element.volume != "pointwise" or problem.kinematics.plane_stress:
        return []
    moduli = [(part, *part.region.material.lame) for part in problem.elastic.parts]
    return [part for part, mu, lam in moduli if lam >= _LEAST_RATIO * mu]


def pressure_oscillation(problem: Problem, parts: Sequence[Part]) -> float:
    """Return the largest rho of some materials at the problem's state. Collective.

    It is 0 for a state that is not distinguished from rest by the solver's tolerance.
    """
    if not parts:
        return 0.0
    residual = problem.x.duplicate()
    problem.residual(problem.x, residual)
    least = _RESOLVED * residual.norm() / problem.force_scale
    u = local_values(problem.split(problem.x)[0])
    Q = _dolfinx.function_space(problem.domain, 1)
    points, _ = _dolfinx.quadrature(problem.element.cell, problem.element.quadrature)
    basis, nodes = _dolfinx.tabulate_values(Q, points), _dolfinx.node_dofs(Q)
    found = []
    for part in parts:
        state = point_volumes(part.loops.tables, u)
        rough = _distance_to_nodal_means(Q, nodes[part.region.cells], basis, state)
        integrals = np.array([rough, state.shear, state.strain, state.weights.sum()])
        integrals = problem.comm.allreduce(integrals)
        distance, shear, strain, size = (sqrt(max(0.0, square)) for square in integrals)
        mu, lam = part.region.material.lame
        scale = 2 * mu * (shear + _ROUNDING * strain)
        found.append(lam * distance / scale if strain > least * size else 0.0)
    return max(found)


def _distance_to_nodal_means(
    Q: _dolfinx.FunctionSpace, nodes: Any, basis: Any, state: PointVolumes
) -> float:
    """Return this rank's part of the squared norm of J - Pi J [m^3]. Collective."""
    sums, masses = (
        summed_over_cells(Q, (values @ basis)[..., None], nodes).ravel()
        for values in (state.weights * state.growth, state.weights)
    )
    means = np.divide(sums, masses, out=np.zeros_like(masses), where=masses != 0)
    rough = state.growth - means[nodes] @ basis.T
    return float((state.weights * rough**2).sum())
