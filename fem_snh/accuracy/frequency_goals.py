r"""Frequencies of vibration as goals, and their errors.

The error is the difference between the eigenvalue problems of the run's element and of the lifted
one, each about its own equilibrium. The modes :math:`\varphi` of the run, interpolated exactly, are
those from which inverse iteration begins, with the lifted problem's stiffness K and mass M,

.. math:: (K + s M)\, w = M \varphi,

with a small shift s, for the rigid motions of a free body: these are modes of both, with K v = 0
and w = v / s, which no solve has to find. The frequencies are those of the Rayleigh-Ritz method on
the span of the w, to which modes of one frequency are no trouble. One iteration finds almost all of
the difference (Xu & Zhou 2001, the two-grid method). An unknown
pressure has no mass: it is a part of the linear system. The quotients are stationary in both, so
that what a linear solve leaves enters by its square.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

from fem_snh import _dolfinx
from fem_snh.accuracy.duals import Dual, Linearisation
from fem_snh.accuracy.goals import Goal
from fem_snh.accuracy.lift import Lift
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.unknowns import (
    add_ghosts,
    ghosted,
    local_values,
    set_to_zero,
    update_ghosts,
    writable_values,
)
from fem_snh.problem.modes import SHIFT, LowestModes, VibrationModes
from fem_snh.problem.problem import Problem

Array = npt.NDArray[np.float64]

#: Relative tolerance of the linear solves, whose square is small beside any difference.
_LINEAR = 1e-4
#: The iteration ends when no frequency changes by more than this part of its difference to that of
#: the run, or of itself; and without a result after so many iterations.
_SETTLED, _NEGLIGIBLE, _MOST_ITERATIONS = 0.02, 1e-7, 10
#: Eigenvalues below this part of their scale are those of rigid motions.
_RIGID = 1e-8


class FrequencyGoal(Goal):
    """One of the lowest frequencies of vibration [Hz] about the state.

    Parameters
    ----------
    number : int
        Its number in ascending order, from 1.
    modes : LowestModes
        Computes the modes of a problem.
    label : str, optional
        What it is called; default: frequency.NUMBER.
    """

    def __init__(self, number: int, modes: LowestModes, label: str = "") -> None:
        super().__init__([label or f"frequency.{number}"], "frequency")
        self.number, self.modes = number, modes

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`. The problem has no unknown pressure."""

        def values() -> list[float]:
            frequencies = np.array(self.modes(problem).frequencies)
            return [float(_without_rounding(frequencies, self.unit(problem))[self.number - 1])]

        return values

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`: that of a wave across the body."""
        return _unit(self.modes, problem)

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`: NaN, as most of the error is that of the mode."""
        return at.unknown()


def _unit(modes: LowestModes, problem: Problem) -> float:
    """Return the frequency of a wave across the body [Hz]. Collective."""
    return sqrt(modes.scale(problem)) / (2 * pi)


def _without_rounding(frequencies: Array, unit: float) -> Array:
    """Return frequencies with zeros for those of rigid motions."""
    return np.where(np.abs(frequencies) <= unit * sqrt(_RIGID), 0.0, frequencies)


@dataclass
class LiftedModes:
    """The modes of the lifted problem at its solution, from those of the run.

    Attributes
    ----------
    frequencies, unsettled : (modes,) array
        In ascending order [Hz], and by how much the last iteration changed them.
    shapes : list of PETSc.Vec
        The modes, with v . M v = 1, ghosted vectors of the displacement's space.
    changes : list of PETSc.Vec
        The part of each mode of the run that is outside of their span.
    """

    frequencies: Array
    unsettled: Array
    shapes: list[PETSc.Vec]
    changes: list[PETSc.Vec]


def lifted_modes(lift: Lift, modes: LowestModes) -> LiftedModes | None:
    """Return the modes of the lifted problem; None if a solver does not converge. Collective.

    Parameters
    ----------
    lift : Lift
        The lifted problem at its solution.
    modes : LowestModes
        Computes the modes of the run.
    """
    problem, lifted = lift.problem, lift.lifted
    mass = NodalMass(lifted.V, modes.regions(lifted), kinematics=lifted.kinematics)
    shift = SHIFT * modes.scale(lifted)
    with _shifted(lifted, mass, shift):
        at = Linearisation(lifted, lifted.x, lift.linear_solves(True, _LINEAR, ("exact",)))
    found, unit = modes(problem), _unit(modes, problem)
    of_run = [_interpolated(found, i, lifted) for i in range(1, len(found.shapes) + 1)]
    frequencies = _without_rounding(np.array(found.frequencies), unit)
    shapes, values = of_run, frequencies
    for _ in range(_MOST_ITERATIONS):
        rigid = [shape for shape, value in zip(shapes, values, strict=True) if value == 0]
        others = [shape for shape, value in zip(shapes, values, strict=True) if value != 0]
        unknowns, before = at.solve([_load(at, mass, shape) for shape in others]), values
        if not all(np.isfinite(x.norm()) for x in unknowns):
            return None
        solutions = [*rigid, *(_displacement(lifted, x) for x in unknowns)]
        inertia = _dots(solutions, [_product(mass, w) for w in solutions])
        stiffness, n = shift * inertia, len(rigid)
        stiffness[n:, n:] = _dots(unknowns, [lifted.operator * x for x in unknowns])
        eigenvalues, vectors = eigh(stiffness, inertia)
        shapes = [_combined(solutions, column) for column in vectors.T]
        eigenvalues -= shift
        values = np.sign(eigenvalues) * np.sqrt(np.abs(eigenvalues)) / (2 * pi)
        values = _without_rounding(values, unit)
        changes = np.abs(values - before)
        limits = _SETTLED * np.abs(values - frequencies) + _NEGLIGIBLE * values.max()
        if (changes <= limits).all():
            break
    else:
        return None
    loads = [_product(mass, shape) for shape in shapes]
    parts = _dots(of_run, loads)
    outside = [v - _combined(shapes, row) for v, row in zip(of_run, parts, strict=True)]
    return LiftedModes(values, changes, shapes, outside)


@contextmanager
def _shifted(problem: Problem, mass: NodalMass, factor: float) -> Iterator[None]:
    """Add a multiple of the mass matrix to the Hessians that are assembled."""
    terms: list[Any] = problem.terms
    terms.append(_Shift(mass, factor))
    try:
        yield
    finally:
        terms.pop()


class _Shift:
    """The term s M of a Hessian: that of a potential whose minimum is the present state."""

    def __init__(self, mass: NodalMass, factor: float) -> None:
        self._mass, self._factor = mass, factor

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add no forces."""

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add s M, and return 0: it is positive definite."""
        self._mass.add_to(target, self._factor)
        return 0


def _interpolated(modes: VibrationModes, number: int, lifted: Problem) -> PETSc.Vec:
    """Return a mode in the space of the lifted problem, a ghosted vector. Collective."""
    target = _dolfinx.function(lifted.V, "mode")
    target.interpolate(modes.function(number))
    return ghosted(lifted.V, target.x.array[: lifted.owned_displacements])


def _load(at: Linearisation, mass: NodalMass, shape: PETSc.Vec) -> PETSc.Vec:
    """Return the product of the mass matrix with a mode, reduced to the unknowns. Collective."""
    load = at.problem.x.duplicate()
    load.set(0.0)
    product = _product(mass, shape)
    load.array[: product.getLocalSize()] = product.array_r
    at.reduce(load)
    return load


def _displacement(problem: Problem, x: PETSc.Vec) -> PETSc.Vec:
    """Return the displacement of a vector of the unknowns, a ghosted vector. Collective."""
    x = x.copy()
    if problem.rigid:
        problem.rigid.expand(problem.x, x.array)
    return ghosted(problem.V, x.array_r[: problem.owned_displacements])


def _product(mass: NodalMass, vector: PETSc.Vec) -> PETSc.Vec:
    """Return the product of the mass matrix with a ghosted vector. Collective."""
    product = vector.duplicate()
    writable_values(product)[:] = mass.apply(local_values(vector))
    add_ghosts(product)
    return product


def _dots(left: Sequence[PETSc.Vec], right: Sequence[PETSc.Vec]) -> Array:
    """Return all scalar products. Collective."""
    return np.array([[a.dot(b) for b in right] for a in left])


def _combined(vectors: Sequence[PETSc.Vec], factors: Array) -> PETSc.Vec:
    """Return a linear combination of ghosted vectors. Collective."""
    total = vectors[0].duplicate()
    set_to_zero(total)
    total.maxpy(factors.tolist(), list(vectors))
    update_ghosts(total)
    return total
