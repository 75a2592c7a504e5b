r"""Rigid motions of a body that nothing constrains, found before the first step.

Each connected part of the mesh has six rigid motions m, fewer in two dimensions. Conditions and
joints are rows w of constraints, :math:`w \cdot m = 0`. Springs and other terms resist a motion by
the stiffness :math:`m \cdot (\partial f / \partial u) m`. The unconstrained motions are the null
space of the sum of all :math:`w w^T` and stiffnesses, a matrix with six rows for each part.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh._petsc import vector_like
from fem_snh.arrays import Array
from fem_snh.assembly.connected_parts import components, connected_parts
from fem_snh.errors import BadInput
from fem_snh.geometry.rotations import rigid_displacements, rotate
from fem_snh.problem.problem import Problem
from fem_snh.records.run_record import Note
from fem_snh.terms.term import Term

#: An eigenvalue below this part of the largest one belongs to a free motion. It is the square of
#: the supports' extent relative to the body's.
_FREE = 1e-10
#: Least net work of the loads along a motion, over their absolute work, that is not rounding.
_NET = 1e-6
#: Loads at which forces are examined.
_LOADS = (1.0, 0.5, 0.25)
#: Motion by which forces are differenced, relative to the body's length. Rotations are finite, so
#: an objective energy of a program has no error but rounding.
_DIFFERENCE = 1e-4
#: Larger motions, in the same unit, at which forces are compared: a UFL form of contact resists
#: only there.
_FAR = (0.03, 0.3, 3.0)
#: Work of the change of forces along a motion, relative to E L^2, below which it is rounding.
_RESISTS = 1e-9
#: A component of a unit direction or of a motion below this is zero.
_SHOWN = 1e-6


class FreeMotion(NamedTuple):
    """A rigid motion that nothing constrains.

    Attributes
    ----------
    part : int
        The connected part that moves: 0 is the largest; -1 for several parts together.
    kind : {"translation", "rotation"}
    axis : (3,) array
        The direction of the translation or of the rotation's axis, of length 1.
    work : float
        The largest ratio, over the loads, of their net work along the motion to their absolute
        work; 0 without a net force.
    resists : bool
        Whether forces of the terms change along the motion far from rest, and may hold the body.
    """

    part: int
    kind: str
    axis: Array
    work: float
    resists: bool


class Supports:
    """The connected parts of a body, and the constraints of their rigid motions. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, before its first step.

    Attributes
    ----------
    labels : (owned nodes,) int
        The connected part of each node.
    sizes : (parts,) int
        Nodes of each part on all ranks, descending.
    left : (6 * parts, n) array
        A basis of the motions that conditions and joints do not constrain.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._comm = problem, problem.comm
        self.labels, self.sizes = _connected_parts(problem)
        X, kinematics = problem.coordinates, problem.kinematics
        count = self._comm.allreduce(len(X))
        self._origin = self._comm.allreduce(X.sum(axis=0)) / count
        if kinematics.revolved:
            self._origin[0] = 0.0  # it is on the axis
        self._r = (X - self._origin) / problem.length
        modes = rigid_displacements(self._r)[:, :, : kinematics.components]
        #: The displacement of each node in a rigid motion, (owned nodes, components, 6).
        self._modes = np.ascontiguousarray(np.moveaxis(modes, 0, 2))
        if problem.rigid:
            motions = self.labels, self._origin, problem.length, len(self.sizes)
            self._twists = problem.rigid.twists(*motions)
        self.left = _null_space(self._conditions())

    def free_motions(self) -> list[FreeMotion]:
        """Return the motions that neither constraints nor terms prevent at present. Collective."""
        if not (free := self.left).shape[1]:
            return []
        problem = self._problem
        present = problem.load
        rest = [term for term in problem.terms[1:] if not term.is_contact]
        with problem.kept_fields():
            problem.set_load(0.0)
            free = free @ _null_space(self._stiffness(free, rest))
            modes = _sorted_modes(free)
            resists = [self._resists(mode, rest) for mode in modes]
            works = [self._net_work(mode, rest) for mode in modes]
            problem.set_load(present)
        return [
            FreeMotion(*_describe(mode), work, resisted)
            for mode, work, resisted in zip(modes, works, resists, strict=True)
        ]

    def _conditions(self) -> Array:
        """Return the sum of w w^T of Dirichlet conditions and rigid parts, (6 parts, 6 parts)."""
        problem, modes = self._problem, self._modes
        sums = np.zeros((len(self.sizes), 6, 6))
        node, component = np.nonzero(problem.dirichlet.constrained[: len(modes)])
        rows = modes[node, component]
        np.add.at(sums, self.labels[node], rows[:, :, None] * rows[:, None])
        if planes := problem.dirichlet.planes:
            own = slice(planes.num_owned)
            nodes, of = planes.nodes[own], modes[planes.nodes[own]]
            blocks = np.einsum("nik,nij,njl->nkl", of, planes.bases[own], of)
            np.add.at(sums, self.labels[nodes], blocks)
        none = np.diag(1.0 - np.array(problem.kinematics.rigid_motions))
        gram = np.zeros((6 * len(sums), 6 * len(sums)))
        for part, block in enumerate(self._comm.allreduce(sums)):
            own_motions = slice(6 * part, 6 * part + 6)
            gram[own_motions, own_motions] = block + none * max(1.0, np.trace(block))
        if problem.rigid:
            rows = problem.rigid.inadmissible(self._twists) / problem.length
            gram += rows.T @ rows
        return gram

    def _field(self, mode: Array) -> Array:
        """Return a motion's displacements of the nodes, (owned nodes, components)."""
        return np.asarray(np.einsum("nik,nk->ni", self._modes, mode.reshape(-1, 6)[self.labels]))

    def _moved(self, mode: Array, size: float) -> Array:
        """Return ``size`` times a motion with finite rotations, (owned nodes, components) [m]."""
        twists, length = size * mode.reshape(-1, 6)[self.labels], self._problem.length
        found = twists[:, :3] + rotate(twists[:, 3:], self._r) - self._r
        return length * found[:, : self._modes.shape[1]]

    def _forces(self, u: Array, terms: Sequence[Term]) -> Array:
        """Return the forces dE/du [N] of terms at a displacement, (owned nodes, components)."""
        problem = self._problem
        f = problem.gradient_at(vector_like(problem.x, u.ravel()), terms)
        return np.array(problem.nodal(f))

    def _stiffness(self, free: Array, terms: Sequence[Term]) -> Array:
        """Return the stiffness (n, n) of terms along motions, relative to E L; I if not finite."""
        problem, count = self._problem, free.shape[1]
        h, found = _DIFFERENCE, np.zeros((count, count))
        fields = [self._field(mode) for mode in free.T]
        for j, mode in enumerate(free.T):
            ends = [self._forces(self._moved(mode, step), terms) for step in (h, -h)]
            for i, other in enumerate(fields):
                work = float(((ends[0] - ends[1]) * other).sum())
                found[i, j] = self._comm.allreduce(work) / (2 * h * problem.length)
        found /= problem.force_scale / problem.length
        if not np.isfinite(found).all():
            return np.eye(count)
        if problem.rigid:
            springs = problem.rigid.stiffness_at_rest(self._twists @ free)
            found += springs / (problem.modulus * problem.length**3)
        return (found + found.T) / 2

    def _resists(self, mode: Array, terms: Sequence[Term]) -> bool:
        """Return whether terms resist a motion of one of the sizes `_FAR`. Collective."""
        field, scale = self._field(mode), self._problem.force_scale
        rest = self._forces(np.zeros_like(field), terms)
        for step in (sign * size for size in _FAR for sign in (1, -1)):
            change = self._forces(self._moved(mode, step), terms) - rest
            work = self._comm.allreduce(float((change * field).sum()))
            if not abs(work) <= _RESISTS * scale:  # NaN is a resistance
                return True
        return False

    def _net_work(self, mode: Array, terms: Sequence[Term]) -> float:
        """Return the largest ratio of net to absolute work of the loads along a motion.

        0 if it is rounding. The problem's load changes. Collective.
        """
        problem, moved, largest = self._problem, self._field(mode), 0.0
        for load in _LOADS:
            problem.set_load(load)
            f = self._forces(np.zeros_like(moved), terms)
            work = np.array([(f * moved).sum(), (np.abs(f) * np.abs(moved)).sum()])
            net, total = self._comm.allreduce(work)
            if problem.rigid:
                more = problem.rigid.work_at_rest(self._twists @ mode) / problem.length
                net, total = net + more.sum(), total + np.abs(more).sum()
            if total > 0:
                largest = max(largest, abs(net) / total)
        return largest if largest > _NET else 0.0


class SupportsCheck:
    """The check of a static body's supports before it is solved.

    Conditions and joints are examined once. Springs, other terms and loads are examined by each
    `check`, as a program may change them.

    Parameters
    ----------
    problem : Problem
        The problem. If it moves in time, nothing is checked.

    Attributes
    ----------
    notes : list of Note
        The note on free motions that the last `check` found, or no note.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self.notes = problem, list[Note]()

    @cached_property
    def _supports(self) -> Supports | None:
        """The supports; None if conditions and joints constrain all motions. Collective."""
        if self._problem.motion is not None:
            return None
        supports = Supports(self._problem)
        return supports if supports.left.shape[1] else None

    def check(self) -> None:
        """Set the notes; the problem's state stays unchanged. Collective.

        Raises
        ------
        BadInput
            On every rank, if loads do work along a free motion, unless contact, or a term that
            resists far from rest, may hold the body.
        """
        self.notes.clear()
        if not (self._supports and (motions := self._supports.free_motions())):
            return
        text = _listed(motions, self._supports)
        contact = any(term.is_contact for term in self._problem.terms[1:])
        loaded = [motion for motion in motions if motion.work and not motion.resists]
        if contact:
            text += "; contact alone can hold it"
        elif loaded:
            raise BadInput(
                f"supports: {_listed(loaded, self._supports)}, along which loads act: expected "
                "conditions, springs, joints, or a motion in time"
            )
        elif any(motion.work for motion in motions):
            text += "; only forces of terms that act elsewhere can hold it"
        else:
            text += "; the solution is one of many that differ by it"
        self.notes.append(Note("supports", text))


def _listed(motions: Sequence[FreeMotion], supports: Supports) -> str:
    """Return the motions in words, the first six by name."""
    several = len(supports.sizes) > 1
    whole, words = "the body", []
    for motion in motions:
        axis = np.where(np.abs(motion.axis) > _SHOWN, motion.axis, 0.0)
        unit = np.flatnonzero(axis)
        name = "xyz"[unit[0]] if len(unit) == 1 else "[" + ", ".join(f"{a:.3g}" for a in axis) + "]"
        where = "along" if motion.kind == "translation" else "about"
        part = ""
        if several:
            nodes = "several parts" if motion.part < 0 else f"part {motion.part + 1}"
            size = "" if motion.part < 0 else f", {supports.sizes[motion.part]:,} nodes"
            part = f" of {nodes}{size}"
        words.append(f"the {motion.kind} {where} {name}{part}")
    shown = words[:6] + [f"{len(words) - 6} more"] * (len(words) > 6)
    return f"nothing constrains {'' if several else whole + ': '}{', '.join(shown)}"


def _null_space(gram: Array) -> Array:
    """Return an orthonormal basis (n, k) of the null space of a semidefinite (n, n) matrix."""
    if not len(gram):
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors[:, values <= _FREE * max(1.0, values[-1])])


def _sorted_modes(free: Array) -> list[Array]:
    """Return a basis of the columns of ``free`` with many zeros: single parts, translations."""
    rows, basis = free.T.copy(), list[Array]()
    # Gauss-Jordan elimination with the rotations as first columns: later rows are translations.
    parts = free.shape[0] // 6
    order = [6 * p + k for p in range(parts) for k in (3, 4, 5)]
    order += [6 * p + k for p in range(parts) for k in (0, 1, 2)]
    for column in order:
        if not len(rows):
            break
        pivot = int(np.abs(rows[:, column]).argmax())
        if abs(rows[pivot, column]) < _SHOWN:
            continue
        chosen = rows[pivot] / rows[pivot, column]
        rows = np.delete(rows, pivot, axis=0)
        rows -= rows[:, column : column + 1] * chosen
        basis = [b - b[column] * chosen for b in basis] + [chosen]
    return basis[::-1]


def _describe(mode: Array) -> tuple[int, str, Array]:
    """Return part, kind and axis of a motion, as in `FreeMotion`."""
    twists = mode.reshape(-1, 2, 3)
    moving = np.flatnonzero(np.abs(twists).max(axis=(1, 2)) > _SHOWN)
    part = int(moving[0])
    kind = int(np.abs(twists[part, 1]).max() > _SHOWN)
    axis = twists[part, kind]
    single = part if len(moving) == 1 else -1
    return single, ("translation", "rotation")[kind], axis / np.linalg.norm(axis)


def _connected_parts(problem: Problem) -> tuple[Array, Array]:
    """Return the labels (owned nodes,) and the sizes of `Supports`. Collective.

    Nodes of a cell, and nodes of a rigid part, are connected.
    """
    comm, rigid = problem.comm, problem.rigid
    part, count = connected_parts(problem.V)
    if rigid:
        nodes = np.zeros((len(rigid.names), count))
        np.add.at(nodes, (rigid.labels, part[rigid.nodes]), 1.0)
        links = np.argwhere(comm.allreduce(nodes)) + np.array([count, 0])
        part = components(links, count + len(rigid.names))[part]
    part = part[: _dolfinx.num_nodes(problem.V)[0]]
    sizes = comm.allreduce(np.bincount(part, minlength=count))
    order = np.argsort(-sizes, kind="stable")
    return np.argsort(order)[part], sizes[order][: int((sizes > 0).sum())]
