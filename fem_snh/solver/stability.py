r"""Stability of equilibria: the inertia of the exact Hessian.

The Hessian at a minimum of the energy has no negative eigenvalues. With pressures as unknowns, in
which the energy has a maximum, it has as many negative eigenvalues as there are pressures (Benzi,
Golub & Liesen 2005, section 3.4).

Conjugate gradients can prove that H is definite without factors. After k iterations for
:math:`H x = b`, the component of the residual in an eigenvector of the preconditioned H with the
eigenvalue t is :math:`R_k(t) = \prod_j (1 - t/\theta_j)` times its initial value, with the Ritz
values :math:`\theta_j` (Saad 2011, sec. 6.7). While all :math:`\theta_j` are positive,
:math:`R_k(t) > 1` for t < 0. So the residual's component of a negative eigenvalue grows until a
direction of negative curvature is met. With a random b the component is :math:`\|b\|/\sqrt n` on
average: if the residual falls far below this, no eigenvalue is negative. As the coarse matrix of
the deflation is definite too, so is H (Haynsworth 1968).

With a pressure as an unknown, the displacement's block H may be indefinite at a stable equilibrium:
stability requires that :math:`S = H + B^T C^{-1} B` is definite. If H is definite, so is S. If not,
the Lanczos method with :math:`S^{-1}`, the displacement's block of the inverse of the whole matrix,
finds the eigenvalues of S next to zero on either side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from itertools import compress
from math import isfinite, sqrt

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import set_operators, vector_like
from fem_snh.arrays import Array
from fem_snh.errors import BadInput
from fem_snh.geometry.rotations import rigid_displacements
from fem_snh.linalg.direct_solver import SymmetricFactors
from fem_snh.linalg.ssor_cg import context_of
from fem_snh.solver.block_triangular import BlockTriangular
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.linear_choice import MAX_NODES
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.saddle_point import frozen_preconditioner, preconditioner_by_blocks
from fem_snh.solver.step import LineSearch, State, relative_tolerance

#: Largest displacement of the first step along a direction of negative curvature, relative to
#: V^(1/3), and how often it is halved at most while the energy does not decrease.
_FIRST, _HALVINGS = 1e-3, 20
#: Contrast of the shear moduli from which a coarse mesh has several equilibria, some of them
#: unstable (python -m benchmarks extremes --only contrast).
_CONTRAST = 50.0
#: Nodes up to which factors of one Hessian cost less than a load step (twist of Q2Q1 with 8 cells
#: across, 4,913 nodes: 1.7 of 11 s).
_MAX_FACTORED = 5_000
#: The squares of the wave numbers and phases in `_function_of_coordinates`.
_PRIMES = (2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0)
#: Eigenvalues of this magnitude, relative to the diagonal, are zero: rounding leaves 1e-14.
_ZERO = 1e-10
#: Factor of safety on the bound of the eigenvalues of free rotations.
_MARGIN = 2.0


def is_conservative(problem: SolvableProblem) -> bool:
    """Return whether a problem has an energy and no inertia. Collective."""
    return problem.has_energy and not problem.regime.inertia


def are_factors_cheap(problem: SolvableProblem) -> bool:
    """Return whether factors of a Hessian cost less than a load step."""
    return problem.regime.nodes <= _MAX_FACTORED


def no_energy(asked: str, in_time: bool) -> BadInput:
    """Return the exception for a problem that is not conservative.

    ``asked`` names the feature that requires an energy; with ``in_time`` the reason is inertia.
    """
    why = "in time" if in_time else "a load or a material without an energy"
    return BadInput(f"{asked}: expected equilibria of an energy, not {why}")


class EquilibriumStability:
    """The stability of equilibria, by sparse factors of the exact Hessian. Collective.

    The methods assemble into ``problem.P``.

    Parameters
    ----------
    problem : SolvableProblem
    asked : str
        The feature that requires an energy, for the message.

    Raises
    ------
    BadInput
        For a problem that is not one of equilibria of an energy.
    """

    def __init__(self, problem: SolvableProblem, asked: str = "stability") -> None:
        if not is_conservative(problem):
            raise no_energy(asked, in_time=problem.has_energy)
        self._problem = problem

    @property
    def expected(self) -> int:
        """The number of negative eigenvalues at a minimum: the number of pressures."""
        saddle = self._problem.saddle_point
        return int(saddle.index_sets["p"].getSize()) if saddle else 0

    @property
    def is_doubtful(self) -> bool:
        """Whether an equilibrium that iterations find may be unstable, and factors are cheap."""
        return self._problem.regime.contrast >= _CONTRAST and are_factors_cheap(self._problem)

    def negative_eigenvalues(self, x: PETSc.Vec) -> int:
        """Return the number of negative eigenvalues at ``x``, less `expected`.

        Raises
        ------
        Failed
            If the factors do not fit into memory.
        """
        with closing(SymmetricFactors(self._assembled(x))) as factors:
            return self._count(factors)

    def leave(
        self, start: State, search: LineSearch, trial: State, shortest: float = 0.0
    ) -> tuple[int, float]:
        """Set ``trial`` to a state of less energy along a direction of negative curvature.

        Parameters
        ----------
        start : State
            The equilibrium.
        search : LineSearch
            Evaluates energies and residuals.
        trial : State
            The state of less energy, with its residual; undefined without a step.
        shortest : float
            The length up to which the step is doubled whatever the energy.

        Returns
        -------
        int, float
            The number of negative eigenvalues less `expected`, and the 2-norm of the step [m]; 0
            without a step, or if the operator has matrices of rank one.

        Raises
        ------
        Failed
            If the factors do not fit into memory.
        """
        with closing(SymmetricFactors(self._assembled(start.x))) as factors:
            negative, d = self._count(factors), None
            if negative > 0 and self._problem.is_assembled:
                d = factors.negative_direction(negative, _wave(self._problem))
        return negative, 0.0 if d is None else self._descend(start, d, search, trial, shortest)

    def _descend(
        self, start: State, d: PETSc.Vec, search: LineSearch, trial: State, shortest: float
    ) -> float:
        """Double a step along ``d`` while the energy decreases; return its length, or 0."""
        if start.residual.dot(d) > 0:
            d.scale(-1.0)
        step = _FIRST * self._problem.length / d.norm(PETSc.NormType.INFINITY)
        for _ in range(_HALVINGS):
            lowest = search.evaluate_energy(start.x, d, step, trial)
            if search.admits(start.x, trial.x) and lowest < start.energy:
                break
            step *= 0.5
        else:
            return 0.0
        while search.largest_step(start.x, 2 * step * d) == 1:
            energy = search.evaluate_energy(start.x, d, 2 * step, trial)
            if not (energy < lowest or (2 * step <= shortest and isfinite(energy))):
                break
            step, lowest = 2 * step, energy
        search.evaluate_energy(start.x, d, step, trial)
        search.evaluate_residual(trial)
        return step

    def _count(self, factors: SymmetricFactors) -> int:
        """Factorise; return the operator's number of negative eigenvalues, less `expected`."""
        negative = factors.factorise() - self.expected
        if self.expected:  # a pressure that acts on constrained nodes alone has a row of zeros
            negative += factors.null_pivots
        if not self._problem.is_assembled:
            negative -= factors.removed_by(self._problem.operator)
        return negative

    def shift_free_rotations(self, x: PETSc.Vec, least: float = 0.0) -> None:
        """Make the eigenvalues of rotations that nothing constrains positive in ``problem.P``.

        Rounding and the residual at ``x`` give these eigenvalues any sign. The diagonal is
        multiplied by 1 plus the larger of ``least`` and a bound of their magnitude. Collective.
        """
        A = self._problem.P
        rotations = self._free_rotations(x)
        if not (least or rotations):
            return
        diagonal = A.getDiagonal()
        diagonal.scale(1 + max(least, self._of_rotations(x, rotations, diagonal)))
        A.setDiagonal(diagonal)

    def _assembled(self, x: PETSc.Vec) -> PETSc.Mat:
        """Return ``problem.P``, the exact Hessian at ``x``, with zero eigenvalues made positive."""
        self._problem.jacobian(x, "exact")
        self.shift_free_rotations(x, _ZERO)
        return self._problem.P

    def _free_rotations(self, x: PETSc.Vec) -> list[PETSc.Vec]:
        r"""Return the rotations :math:`\omega \times x` that nothing constrains. Collective."""
        problem, kinematics, found = self._problem, self._problem.kinematics, []
        points = problem.coordinates + kinematics.padded(problem.nodal(x))
        if not kinematics.revolved:  # else about the axis of a body of revolution
            points -= self._centre(points)
        projected, rotations = x.duplicate(), rigid_displacements(points)[3:]
        for rotation in compress(rotations, kinematics.rigid_motions[3:]):
            w = vector_like(x, rotation[:, : kinematics.components].ravel())
            w.copy(projected)
            problem.project(projected.array)
            projected.axpy(-1.0, w)
            if projected.norm() <= _ZERO * w.norm():
                found.append(w)
        return found

    def _of_rotations(self, x: PETSc.Vec, free: Sequence[PETSc.Vec], diagonal: PETSc.Vec) -> float:
        r"""Return a bound of the eigenvalues of free rotations, relative to the diagonal.

        A rotation :math:`w = \omega \times x` on which the energy does not depend has
        :math:`H w = \omega \times r`, which is not zero if the residual r is not.
        """
        if not free:
            return 0.0
        r, weighted, found = x.duplicate(), x.duplicate(), 0.0
        self._problem.residual(x, r)
        norm = r.norm()
        for w in free:
            weighted.pointwiseMult(w, diagonal)
            found = max(found, norm * w.norm() / weighted.dot(w))
        return _MARGIN * found

    def _centre(self, points: Array) -> Array:
        """Return the mean of the constrained nodes' points, or of all points if there are none."""
        ones = self._problem.x.duplicate()
        ones.set(1.0)
        self._problem.project(ones.array)
        held = (self._problem.nodal(ones) != 1).any(axis=1)
        rows = [np.append(chosen.sum(axis=0), len(chosen)) for chosen in (points[held], points)]
        of_held, of_all = self._problem.comm.allreduce(np.array(rows))
        *sums, count = of_held if of_held[-1] else of_all
        return np.array(sums) / count


_Reason = PETSc.KSP.ConvergedReason
_INDEFINITE = (_Reason.DIVERGED_INDEFINITE_MAT, _Reason.DIVERGED_INDEFINITE_PC)
#: The residual is reduced to this fraction of the mean size of a component: a normally distributed
#: component is smaller in 0.4 % of all cases.
_PART = 0.005
#: Iterations after which definiteness is unknown; stable bodies need 20 to 40.
_MAX_IT = 300
#: Lanczos iterations with S^-1, the relative tolerance of their linear solves, and the Ritz value,
#: relative to the largest magnitude, below which an eigenvalue counts as negative.
_LANCZOS, _INVERSE_RTOL, _NEGATIVE = 6, 1e-2, -0.01


def negative_eigenvalues(problem: SolvableProblem, ksp: PETSc.KSP) -> int | None:
    """Return `EquilibriumStability.negative_eigenvalues` at a small part of a solve's cost.

    Conjugate gradients prove that most stable equilibria are stable. Otherwise factors count if
    they are cheap or if Lanczos iterations find negative curvature. None if the number is unknown;
    1 stands for any positive number in bodies that are too large for factors. Collective.

    Parameters
    ----------
    problem : SolvableProblem
        The problem with an unknown pressure, at an equilibrium.
    ksp : PETSc.KSP
        Its linear solver, which is set up anew.
    """
    cheap, iterative = are_factors_cheap(problem), problem.is_assembled
    if iterative:
        problem.jacobian(problem.x, "exact")
        if is_definite(problem, ksp):
            return 0
    if not cheap and not (iterative and has_negative_curvature(problem, ksp)):
        return None
    if problem.regime.nodes > MAX_NODES:
        return 1
    return EquilibriumStability(problem).negative_eigenvalues(problem.x)


@callback_errors()
def is_definite(problem: SolvableProblem, ksp: PETSc.KSP) -> bool | None:
    """Return whether the displacement's block of ``problem.P`` is positive definite. Collective.

    None if iterations do not decide. Changes the matrix by `shift_free_rotations`.

    Parameters
    ----------
    problem : SolvableProblem
        The problem, with its exact Hessian assembled.
    ksp : PETSc.KSP
        Its linear solver, which is set up anew.
    """
    EquilibriumStability(problem).shift_free_rotations(problem.x)
    set_operators(ksp, *ksp.getOperators())  # the preconditioner may be that of the filtered one
    ksp.setUp()
    blocks = preconditioner_by_blocks(ksp.getPC())
    cg = blocks.u if isinstance(blocks, BlockTriangular) else ksp
    if context_of(cg) is None:
        return None
    diagonal = problem.P.getDiagonal()
    x, b = cg.getOperators()[0].createVecs()
    # With this factor the components in all eigenvectors are about equally large.
    size = len(b.array_r)
    b.array[:] = (noise(problem).array_r * np.sqrt(np.abs(diagonal.array_r)))[:size]
    rtol, max_it = cg.getTolerances()[0], cg.getTolerances()[3]
    cg.setTolerances(rtol=_PART / sqrt(b.getSize()), max_it=_MAX_IT)
    cg.solve(b, x)
    cg.setTolerances(rtol=rtol, max_it=max_it)
    reason = cg.getConvergedReason()
    if reason in _INDEFINITE:
        return False
    return True if reason == _Reason.CONVERGED_RTOL else None


@callback_errors()
def has_negative_curvature(problem: SolvableProblem, ksp: PETSc.KSP) -> bool:
    """Return whether Lanczos iterations find a negative eigenvalue of S. Collective.

    Parameters
    ----------
    problem : SolvableProblem
        The problem with an unknown pressure, at an equilibrium.
    ksp : PETSc.KSP
        Its linear solver, which is set up anew.
    """
    assert problem.saddle_point
    size = problem.saddle_point.index_sets["u"].getLocalSize()
    basis, T = [], np.zeros((_LANCZOS, _LANCZOS))
    comm, f, x = problem.comm, noise(problem), problem.x.duplicate()
    problem.jacobian(problem.x, "clamp")
    problem.saddle_point.update_schur_approximation(problem.P)

    def assemble() -> None:
        problem.jacobian(problem.x, "exact")
        EquilibriumStability(problem).shift_free_rotations(problem.x)

    with (
        relative_tolerance(ksp, _INVERSE_RTOL),
        frozen_preconditioner(ksp, problem.operator, problem.P, assemble),
    ):
        for k in range(_LANCZOS):
            f.array[size:] = 0.0
            f.normalize()
            basis.append(f.array_r[:size].copy())
            ksp.solve(f, x)
            if not ksp.getConvergedReason() > 0:
                return False
            w, Q = x.array_r[:size].copy(), np.array(basis)
            for _ in range(2):  # twice is enough (Parlett 1998, section 6.9)
                part = comm.allreduce(Q @ w)
                T[: k + 1, k] += part
                w -= part @ Q
            ritz = np.linalg.eigvalsh(T[: k + 1, : k + 1], UPLO="U")
            if ritz[0] < _NEGATIVE * np.abs(ritz).max():
                return True
            f.array[:size] = w
    return False


def noise(problem: SolvableProblem) -> PETSc.Vec:
    """Return irregular displacements in [-1, 1], zero where constrained, and zero pressures.

    The values are functions of the coordinates, the same on any number of ranks.
    """
    return _function_of_coordinates(problem, 1e4, lambda phases: np.sin(1e3 * np.sin(phases)))


def _wave(problem: SolvableProblem) -> PETSc.Vec:
    """Return a smooth displacement without symmetry, the same on any number of ranks."""
    return _function_of_coordinates(problem, 1.0, np.sin)


def _function_of_coordinates(
    problem: SolvableProblem, frequency: float, function: Callable[[Array], Array]
) -> PETSc.Vec:
    """Return displacements: ``function`` of the phases of three waves, zero where constrained."""
    points, primes = problem.coordinates / problem.length, np.array(_PRIMES)
    # Irrational wave numbers and phases: no plane of symmetry of a body maps it to itself.
    phases = points @ np.sqrt(frequency * primes[:9].reshape(3, 3)) + np.sqrt(primes[9:])
    values = function(phases)[:, : problem.nodal(problem.x).shape[1]]
    vector = vector_like(problem.x, values.ravel())
    problem.project(vector.array)
    return vector
