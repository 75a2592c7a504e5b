"""Notes on a converged state: locking, inverted points, missed contact, instability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.assembly.cell_loops import PointStrains, cell_centres, point_strains
from fem_snh.assembly.unknowns import local_values, summed_over_cells
from fem_snh.problem.problem import Problem
from fem_snh.records.run_record import Note
from fem_snh.terms.elastic import Part
from fem_snh.terms.history import SETTLED

#: The element without locking on the same cells that replaces an element.
REPLACEMENTS = {"P1": "P2P0", "P2": "P2P0", "Q1": "Q1P0", "Q2": "Q2Q1"}
#: `pressure_oscillation` from which it is reported (docs/results/locking.md).
_ROUGH = 1.0

#: Part of the largest force from which that on supports without an area is reported: on those that
#: only prevent rigid motions it is what the solvers leave.
_CARRIES = 1e-3

#: Part of the largest kinetic energy, work or dissipation by which an energy may rise by itself.
_RISE = 0.05


def state_notes(problem: Problem, rounding: float, step: int | None = None) -> list[Note]:
    """Return the notes on a state. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    rounding : float
        See `rounding_note`.
    step : int, optional
        Number of the step of a run.
    """
    found = [locking_note(problem, step), inversion_note(problem, step)]
    found += [pressure_note(problem), thin_support_note(problem, step)]
    found += [rounding_note(problem, rounding, step), untreated_volume_note(problem)]
    return [note for note in found if note]


def program_notes(problem: Problem, negative: int | None, rounding: float) -> list[Note]:
    """Return the notes on a program's state, of whose Hessian eigenvalues may be ``negative``."""
    unstable = instability_note({0: negative or 0}, problem)
    contradictions = [Note("load", text) for text in problem.dirichlet.contradictions()]
    return [*state_notes(problem, rounding), *filter(None, [unstable]), *contradictions]


def untreated_volume_note(problem: Problem) -> Note | None:
    """Return a note if an element treats volume terms, and no material has one."""
    if problem.regions or problem.definition.volume or problem.element.volume == "pointwise":
        return None
    text = (
        f"element = '{problem.element.name}' has no effect without a material: it treats the "
        "volume terms of materials and the argument 'volume', and no forms; give the volume term "
        "as volume = lambda J: ..., and the rest as forms"
    )
    return Note("locking", text)


def pressure_note(problem: Problem) -> Note | None:
    """Return a note if the pressure is determined up to a constant only. Collective."""
    if not problem.pressure_level_is_free:
        return None
    text = (
        "nu = 0.5, and the whole boundary is prescribed: the pressure is known up to a constant, "
        "and with it stresses and the forces on the boundary; leave a part of it free, or take "
        "nu < 0.5"
    )
    return Note("pressure", text)


def thin_support_note(problem: Problem, step: int | None = None) -> Note | None:
    """Return a note if constrained points or edges carry a force. Collective.

    They have no area: the finer the mesh, the smaller the force that a prescribed displacement
    needs there, down to zero.
    """
    if (thin := problem.dirichlet.thin_supports) is None:
        return None
    held = problem.gradient_at(problem.x).array_r[thin.dofs]
    force = float(np.sqrt(problem.comm.allreduce(float(held @ held), op=MPI.SUM)))
    if force <= _CARRIES * problem.largest_force(problem.x) or is_at_rest(problem):
        return None
    text = (
        f"{thin.text}: points and edges have no area, and carry a force, {force:.3g} N: with finer "
        "meshes it tends to zero, or the body gives way there without a limit; constrain surfaces"
    )
    return Note("supports", text, step, {"force": force})


def rounding_note(problem: Problem, rounding: float, step: int | None = None) -> Note | None:
    """Return a note if the forces of a static state are known to their rounding error only.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    rounding : float
        The rounding error [N] that ended the solve above its tolerance, or 0.
    step : int, optional
        Number of the last step.
    """
    force = problem.largest_force(problem.x) if rounding and problem.motion is None else 0.0
    if not force or (rounding >= force and not forces_act(problem)):
        return None
    text = (
        f"the rounding error of the residual is {100 * rounding / force:.2g} % of the forces that "
        "act: displacements and forces are no more accurate"
    )
    if any(term.rounds_identity for term in problem.terms):
        text += (
            "; larger loads are, and energies of fem_snh instead of UFL, which rounds I + grad u"
        )
    return Note("rounding", text, step, {"part": rounding / force})


def locking_note(problem: Problem, step: int | None = None) -> Note | None:
    """Return a note if the element locks in the problem's state. Collective."""
    parts = may_lock(problem)
    roughness = pressure_oscillation(problem, parts)
    if roughness < _ROUGH:
        return None
    name, nu = problem.element.name, max(part.region.material.numbers.nu for part in parts)
    other = REPLACEMENTS[name]
    degree = " and a displacement of degree 2" if name == "P1" else ""
    text = (
        f"element = '{name}' locks at nu = {nu:g}: its pressure oscillates by {roughness:.2g} "
        "times the shear stress, so stresses are wrong, and the body may be too stiff: take "
        f"element = '{other}'{degree}"
    )
    return Note("locking", text, step, {"oscillation": roughness, "replacement": other})


def inversion_note(problem: Problem, step: int | None = None) -> Note | None:
    """Return a note if quadrature points are inverted in the problem's state. Collective."""
    if not problem.elastic.parts:
        return None
    fields, comm = problem.cell_fields(problem.x), problem.comm
    if comm.allreduce(float(fields["min_J"].min(initial=np.inf)), op=MPI.MIN) > 0:
        return None
    means = fields["deformed_volume"] / fields["volume"]
    lowest = comm.allreduce(float(means.min(initial=np.inf)), op=MPI.MIN)
    highest = comm.allreduce(float(means.max(initial=-np.inf)), op=MPI.MAX)
    found, of, material = inverted_points(problem)
    where, inside = ", ".join(f"{x:.4g}" for x in found["position"]), ""
    if len(problem.regions) > 1:
        name = problem.elastic.parts[material].region.material.name
        inside = f" in material {material} ({name})"
    text = (
        f"{found['points']:,} of {of:,} quadrature points are inverted, in {found['cells']:,} "
        f"cells: smallest J = {found['min_J']:.3g} at ({where}){inside}; the means over cells, "
        f"which fields and pictures show as J, are {lowest:.3g} to {highest:.3g}: refine the mesh "
        "there, or load less"
    )
    return Note("inverted", text, step, found | {"min_cell_J": lowest})


def unseen_penetrations(row: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the obstacles and pairs in which the body is deeper than contact sees, deepest first.

    Parameters
    ----------
    row : mapping
        A step's row of run.json, or what the terms add to it.

    Returns
    -------
    list of (str, mapping)
        Each one's kind and name, "obstacle 'plate'", and its row.
    """
    kinds = {"obstacle": row.get("obstacles", {}), "contact": row.get("contacts", {})}
    found = [
        (f"{kind} '{name}'", about)
        for kind, rows in kinds.items()
        for name, about in rows.items()
        if "deepest_at" in about
    ]
    return sorted(found, key=lambda pair: -float(pair[1]["deepest"]))


def instability_note(
    negative: Mapping[int, int],
    problem: Problem,
    of: int | None = None,
    step: int | None = None,
) -> Note | None:
    """Return a note if an equilibrium is unstable.

    Parameters
    ----------
    negative : mapping
        Numbers of negative eigenvalues of the Hessian, by the number of the step.
    problem : Problem
        The problem.
    of : int, optional
        Number of steps; None of a program's last solve, whose step is number 0.
    step : int, optional
        Number of the last step.
    """
    unstable = {number: count for number, count in negative.items() if count > 0}
    if not unstable:
        return None
    last = max(unstable)
    count = unstable[last]
    eigenvalues = f"{count} negative eigenvalue{'s' if count > 1 else ''}"
    where = "" if of is None else f" in {len(unstable)} of {of} steps"
    if of is not None and last != step:
        where += ", not in the last"
    elif list(unstable) == [step]:  # others may not have been examined
        where = " in the last step"
    # No trust region minimises unknown pressures.
    element = " with nu < 0.5 and Q1P0 or P2P0" if problem.saddle_point else ""
    cure = f"take globalization = 'trust_region'{element}, which leaves it, or give the body the "
    if problem.coupling_terms:  # their trust region had found no stable state
        cure = "where surfaces that touch end at the same edge, let one reach beyond the other, or "
        cure += "hold the bodies sideways; or give them the "
    text = (
        f"unstable equilibrium{where}: the Hessian has {eigenvalues}, so a disturbance moves the "
        f"body to another state: {cure}imperfection of a real one"
    )
    values = {"negative_eigenvalues": count, "steps": list(unstable)}
    return Note("unstable", text, None if of is None else last, values)


def stabilisation_note(parts: Mapping[int, float], of: int) -> Note | None:
    """Return a note if steps needed a proximal term.

    Parameters
    ----------
    parts : mapping
        The part of its forces in those that act at the end of each such step, by its number.
    of : int
        Number of steps.
    """
    if not parts:
        return None
    largest = max(parts.values())
    text = (
        f"{len(parts)} of {of} steps were stabilised, as contact alone did not guide the body: by "
        f"a proximal term, whose forces at their ends are at most {largest:.2g} of those that act"
    )
    return Note("stabilised", text, max(parts), {"largest": largest, "steps": list(parts)})


def energy_note(steps: Mapping[int, Mapping[str, Any]]) -> Note | None:
    """Return a note if a motion gains energy that no load gave it.

    Second-order methods have the contact forces of a step's start in half of it, also where contact
    ends within it: time steps that do not resolve that give the body any velocity.

    Parameters
    ----------
    steps : mapping
        The rows of run.json of steps that converged, by number.
    """
    rows = {n: row for n, row in steps.items() if "numerical_dissipation" in row}
    if not rows:
        return None
    worst = min(rows, key=lambda number: float(rows[number]["numerical_dissipation"]))
    gained = -float(rows[worst]["numerical_dissipation"])
    exchanged = max(abs(row[k]) for row in rows.values() for k in ("kinetic", "work", "dissipated"))
    if not gained > _RISE * exchanged:
        return None
    text = (
        f"the energy rises by {gained:.3g} J that no load gives, up to time "
        f"{rows[worst]['time']:.4g} s, {100 * gained / exchanged:.2g} % of the largest kinetic "
        "energy, work or dissipation: the time steps do not resolve the motion or its contacts; "
        "take shorter ones, or integrator = 'bdf2'"
    )
    return Note("energy", text, worst, {"gained": gained, "exchanged": exchanged})


def penetration_note(steps: Mapping[int, Mapping[str, Any]]) -> Note | None:
    """Return a note if the body is deeper in an obstacle or surface than contact sees.

    Parameters
    ----------
    steps : mapping
        The rows of run.json of steps that converged, by number.
    """
    unseen = {number: found for number in steps if (found := unseen_penetrations(steps[number]))}
    if not unseen:
        return None
    step = max(unseen, key=lambda number: float(unseen[number][0][1]["deepest"]))
    found, row = unseen[step], steps[step]
    name, about = found[0]
    depth, seen, position = (about[key] for key in ("deepest", "penetration", "deepest_at"))
    where = ", ".join(f"{x:.4g}" for x in position)
    others = f" (and {', '.join(other for other, _ in found[1:])})" if found[1:] else ""
    text = (
        f"{name}{others}: in {len(unseen)} of {len(steps)} steps a surface is deep between the "
        f"points at which contact acts: {depth:.3g} m at ({where}) at load {row['load']:.6g}, the "
        f"points {seen:.3g} m; a force is missing there: refine the mesh, or round the corner"
    )
    values = {"name": name, "deepest": depth, "penetration": seen, "position": position}
    return Note("penetration", text, step, values | {"steps": list(unseen)})


def has_settled(row: Mapping[str, Any]) -> bool:
    """Return whether another search would change no force of self-contact in a row of run.json."""
    return float(row.get("self_contact", {}).get("change", 0.0)) <= SETTLED


def targets_note(steps: Mapping[int, Mapping[str, Any]]) -> Note | None:
    """Return a note if another search for targets would change forces of self-contact.

    Parameters
    ----------
    steps : mapping
        The rows of run.json of steps that converged, by number.
    """
    found = {n: row["self_contact"]["change"] for n, row in steps.items() if not has_settled(row)}
    if not found:
        return None
    step = max(found, key=lambda number: float(found[number]))
    text = (
        f"self-contact: in {len(found)} of {len(steps)} steps another search for the faces that "
        "points are pushed to would change forces at single nodes by up to "
        f"{100 * found[step]:.2g} % of the largest (at load {steps[step]['load']:.6g}): take sums "
        "of forces, not single ones"
    )
    return Note("targets", text, step, {"change": found[step], "steps": list(found)})


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
        J = 1 + point_strains(part.loops.tables, u).growth
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
LOCKING_RATIO = 4.0
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
    return [part for part, mu, lam in moduli if lam >= LOCKING_RATIO * mu]


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
        state = point_strains(part.loops.tables, u)
        rough = _distance_to_nodal_means(Q, nodes[part.region.cells], basis, state)
        integrals = np.array([rough, state.shear, state.strain, state.weights.sum()])
        integrals = problem.comm.allreduce(integrals)
        distance, shear, strain, size = (sqrt(max(0.0, square)) for square in integrals)
        mu, lam = part.region.material.lame
        scale = 2 * mu * (shear + _ROUNDING * strain)
        found.append(lam * distance / scale if strain > least * size else 0.0)
    return max(found)


def _distance_to_nodal_means(
    Q: _dolfinx.FunctionSpace, nodes: Any, basis: Any, state: PointStrains
) -> float:
    """Return this rank's part of the squared norm of J - Pi J [m^3]. Collective."""
    sums, masses = (
        summed_over_cells(Q, (values @ basis)[..., None], nodes).ravel()
        for values in (state.weights * state.growth, state.weights)
    )
    means = np.divide(sums, masses, out=np.zeros_like(masses), where=masses != 0)
    rough = state.growth - means[nodes] @ basis.T
    return float((state.weights * rough**2).sum())
