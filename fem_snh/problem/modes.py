r"""Eigenfrequencies and mode shapes about an equilibrium, by SLEPc.

The lowest solutions of

.. math:: K \varphi = \omega^2 M \varphi

over the free dofs, with the exact Hessian K of the energy and the consistent mass matrix M.

The method is Krylov-Schur iteration on :math:`(K - s M)^{-1}` with a shift s below every
eigenvalue, so that :math:`K - s M` is positive definite even if K is not (a free body, an unstable
state). A Krylov method can miss copies of a multiple eigenvalue: the six zeros of a free body, the
pairs of a symmetric body. By Sylvester's law of inertia, a factorisation of :math:`K - b M` counts
the eigenvalues below b. If the solver missed some, it solves again, deflated by the eigenvectors
found. If all wanted eigenvalues are far smaller than the shift, as for a slender bar, neither their
transforms nor the bound b resolve them, so the shift decreases with them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.regions import regions_with
from fem_snh.assembly.unknowns import copy_to_function, ghosted
from fem_snh.cache import Stopwatch, untimed
from fem_snh.errors import BadInput, bad_value, check_number, check_whole
from fem_snh.linalg.direct_solver import set_direct_solver
from fem_snh.problem.problem import Problem, check_converged
from fem_snh.solver import PREFIX as SOLVER_PREFIX
from fem_snh.solver.stability import no_energy
from fem_snh.tables.types import INT32_MAX

#: Prefix of SLEPc's options, after the solver's prefix.
PREFIX = "modes_"
#: First shift, in units of E / (density length^2), the scale of the eigenvalues.
SHIFT = 1e-2
#: The shift decreases by this factor while all wanted eigenvalues are smaller by it.
_NEARER = 10.0
#: Least shift over the largest quotient of the matrices' diagonals, an estimate of the largest
#: eigenvalue: rounding of K is 1e-16 of it, and a free body has zero eigenvalues.
_LEAST_SHIFT = 1e-12
#: Shift, in units of `SHIFT`, at which the search for a bound below all eigenvalues stops.
_LOWEST_SHIFT = 1e20
#: The bound of the count is this part below the highest wanted eigenvalue, measured from the shift:
#: more than the error of converged eigenvalues, so that the count is not ambiguous.
_GAP = 1e-5
#: Relative tolerance of residuals, close to rounding, as later solves deflate the eigenvectors.
_TOLERANCE = 1e-12
#: Restarts after which SLEPc gives up.
_MAX_RESTARTS = 1000


class Eigenproblem:
    """Stiffness and mass matrix over the free dofs. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at an equilibrium. Its matrix ``A`` is overwritten.
    density : float or None
        Mass per reference volume [kg/m^3] of the regions without a density of their own.
    prefix : str
        Prefix of SLEPc's options.

    Attributes
    ----------
    K, M : PETSc.Mat
        The matrices over the free dofs.
    mass : float
        The body's mass [kg]; in a plane [kg/m].
    """

    def __init__(self, problem: Problem, density: float | None, prefix: str) -> None:
        self._problem, self._comm, self._prefix = problem, problem.comm, prefix
        regions = regions_with(problem.domain, problem.regions, density)
        mass = NodalMass(problem.V, regions, kinematics=problem.kinematics)
        self.mass = mass.total
        volume = problem.length**problem.kinematics.volume_dimension
        self._scale = problem.modulus * volume / (self.mass * problem.length**2)
        self._basis = _free_basis(problem)
        if problem.rigid:
            problem.rigid.prepare_mass(problem.x)
        mass.assemble(problem.matrix)
        self.M = problem.A.ptap(self._basis)
        problem.jacobian(problem.x, "exact")
        self.K = problem.A.ptap(self._basis)
        for A in (self.K, self.M):
            A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._size = int(self.K.getSize()[0])

    def lowest(self, count: int) -> tuple[np.ndarray, list[PETSc.Vec]]:
        """Return the ``count`` lowest eigenvalues [1/s^2] and eigenvectors with v . M v = 1.

        Raises
        ------
        BadInput
            If no shift is below all eigenvalues, or MUMPS or SLEPc fails.
        """
        shift = -self._size_of(count)
        while below := self._count_below(shift):
            shift *= 10
            if abs(shift) > _LOWEST_SHIFT * self._scale:
                raise BadInput(f"modes: the state has {below} eigenvalues without bound")
        found: list[tuple[float, PETSc.Vec]] = []
        missing = count
        while missing > 0 and len(found) < self._size:
            found += self._solve(shift, min(missing, self._size - len(found)), found)
            found.sort(key=lambda pair: pair[0])
            # Complete if all eigenvalues below the highest wanted one were found.
            bound = found[min(count, len(found)) - 1][0]
            bound -= _GAP * (bound - shift)
            missing = self._count_below(bound) - sum(value < bound for value, _ in found)
            missing = max(missing, count - len(found))
        return np.array([value for value, _ in found[:count]]), [v for _, v in found[:count]]

    def _size_of(self, count: int) -> float:
        """Return the size of the first shift [1/s^2], at most `SHIFT` in its unit.

        It is at most `_NEARER` times the ``count``-th eigenvalue, unless that is rounding.
        """
        quotients = self.K.getDiagonal()
        quotients.pointwiseDivide(quotients, self.M.getDiagonal())
        size, least = SHIFT * self._scale, _LEAST_SHIFT * quotients.max()[1]
        while size > least and self._count_below(size / _NEARER) >= count:
            size /= _NEARER
        return size

    def _shifted(self, shift: float) -> PETSc.Mat:
        """Return K - shift M."""
        A = self.K.copy()
        A.axpy(-shift, self.M)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return A

    def _count_below(self, bound: float) -> int:
        """Return the number of eigenvalues below ``bound``."""
        ksp = PETSc.KSP().create(self._comm)
        ksp.setOperators(self._shifted(bound))
        set_direct_solver(ksp)
        pc = ksp.getPC()
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        factors.setMumpsIcntl(13, 1)  # root front on one rank, else its inertia is not counted
        factors.setMumpsIcntl(24, 1)  # null pivot detection, which MatGetInertia requires
        factors.setMumpsIcntl(14, 50)  # [%] memory beyond the estimate, for pivoting
        pc.setUp()
        if factors.getMumpsInfog(1) < 0:
            raise BadInput(f"modes: MUMPS failed with INFOG(1) = {factors.getMumpsInfog(1)}")
        return int(factors.getInertia()[0])

    def _solve(
        self, shift: float, count: int, known: list[tuple[float, PETSc.Vec]]
    ) -> list[tuple[float, PETSc.Vec]]:
        """Return the eigenpairs nearest to ``shift``, M-orthogonal to ``known`` ones.

        ``count`` or more, but fewer if the Krylov space misses copies of multiple eigenvalues.
        """
        from slepc4py import SLEPc

        eps = SLEPc.EPS().create(self._comm)
        eps.setOptionsPrefix(self._prefix)
        eps.setOperators(self.K, self.M)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
        eps.setDimensions(count)
        eps.setTolerances(_TOLERANCE, _MAX_RESTARTS)
        eps.setTarget(shift)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        if known:
            eps.setDeflationSpace([v for _, v in known])
        st = eps.getST()
        st.setType(SLEPc.ST.Type.SINVERT)
        st.setShift(shift)
        set_direct_solver(st.getKSP())
        eps.setFromOptions()
        eps.solve()
        converged = eps.getConverged()
        if not converged:
            raise BadInput(
                f"modes: SLEPc found none of {count} eigenvalues "
                f"(reason {eps.getConvergedReason()}): try -{self._prefix}eps_max_it, -eps_ncv"
            )
        return [self._eigenpair(eps, i) for i in range(converged)]

    def _eigenpair(self, eps: Any, i: int) -> tuple[float, PETSc.Vec]:
        """Return the Rayleigh quotient and the eigenvector, v . M v = 1, of SLEPc's pair i."""
        v, w = self.K.createVecs()
        eps.getEigenvector(i, v)
        self.M.mult(v, w)
        v.scale(1 / np.sqrt(v.dot(w)))
        self.K.mult(v, w)
        return float(v.dot(w)), v

    def residual(self, value: float, v: PETSc.Vec) -> float:
        """Return the relative residual of an eigenpair: see ``residuals`` of `VibrationModes`."""
        r, w = self.K.createVecs()
        self.K.mult(v, r)
        self.M.mult(v, w)
        size = (abs(value) + self._scale) * w.norm()
        r.axpy(-value, w)
        return float(r.norm() / size)

    def shape(self, v: PETSc.Vec, factor: float) -> _dolfinx.Function:
        """Return ``factor`` times ``v`` on all dofs, zero at constrained dofs, as a new Function.

        The sign makes the entry with the largest absolute value positive.
        """
        problem = self._problem
        x, shape = problem.x.duplicate(), _dolfinx.function(problem.V, "mode")
        self._basis.mult(v, x)
        if problem.rigid:
            problem.rigid.expand(problem.x, x.array)
        high, low = x.max()[1], x.min()[1]
        sign = -1.0 if -low > high * (1 + 1e-6) else 1.0
        x.scale(sign * factor)
        copy_to_function(ghosted(problem.V, x.array_r), shape)
        return shape


def _free_basis(problem: Problem) -> PETSc.Mat:
    """Return the matrix (dofs, free dofs) whose orthonormal columns span the free directions.

    Collective.
    """
    owned, dirichlet = problem.x.getLocalSize(), problem.dirichlet
    is_free = np.ones(owned, dtype=bool)
    is_free[problem.constrained_dofs] = False
    directions: Array = np.empty((0, 1))
    dofs: Array = np.empty((0, 1), dtype=np.int64)
    if dirichlet.planes:
        directions, dofs = dirichlet.planes.free_directions()
        is_free[dofs] = False
    single, first = np.flatnonzero(is_free), problem.x.getOwnershipRange()[0]
    lengths = np.repeat([1, dofs.shape[1]], [len(single), len(dofs)])
    csr = (
        np.concatenate([[0], np.cumsum(lengths)]).astype(PETSc.IntType),
        (first + np.concatenate([single, dofs.ravel()])).astype(PETSc.IntType),
        np.concatenate([np.ones(len(single)), directions.ravel()]),
    )
    sizes = (len(lengths), None), (owned, None)
    basis = PETSc.Mat().createAIJ(sizes, csr=csr, comm=problem.comm)
    return basis.transpose()


#: Largest relative residual of an eigenpair. SLEPc tests the residual of the shifted inverse, which
#: bounds the residual of the pencil only if the factors are accurate.
_LARGEST_RESIDUAL = 1e-4


@dataclass
class VibrationModes:
    """The lowest modes of vibration about a solution.

    Attributes
    ----------
    density : float
        Mean mass per reference volume [kg/m^3].
    mass : float
        The body's mass [kg]; in a plane, per thickness [kg/m].
    length : float
        V^(1/3) [m]; in a plane the root of the area.
    frequencies : list of float
        omega / (2 pi) [Hz] in ascending order; -abs(omega) / (2 pi) where omega^2 < 0, in an
        unstable state.
    residuals : list of float
        ||K phi - omega^2 M phi|| / ((abs(omega^2) + E / (density length^2)) ||M phi||).
    shapes : list of dolfinx Function
        Mode shapes [m] in the displacement's space. The mean square of each, weighted by mass, is
        ``length`` squared; the entry with the largest absolute value is positive.
    seconds : float
        Elapsed time of the computation, without compilation.
    """

    density: float
    mass: float
    length: float
    frequencies: list[float]
    residuals: list[float]
    shapes: list[_dolfinx.Function]
    seconds: float

    def __str__(self) -> str:
        return ", ".join(f"{frequency:.6g}" for frequency in self.frequencies) + " Hz"

    @property
    def record(self) -> dict[str, Any]:
        """The entry of the modes in run.json: all but ``shapes`` and ``seconds``."""
        sizes = {"density": self.density, "mass": self.mass, "length": self.length}
        return {**sizes, "frequencies": self.frequencies, "residuals": self.residuals}


def lowest(
    problem: Problem, density: float | None, count: int, prefix: str = SOLVER_PREFIX + PREFIX
) -> VibrationModes:
    """Return the lowest modes about the state ``problem.x``. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    density : float or None
        Mass per reference volume [kg/m^3] of the regions without a density of their own.
    count : int
        Number of modes.
    prefix : str, optional
        Prefix of SLEPc's options, e.g. ``-snh_modes_eps_monitor``.

    Raises
    ------
    BadInput
        On every rank: see `check`; also if SLEPc fails, or an eigenpair has a large residual.
    """
    watch = Stopwatch()
    with untimed(problem):
        check(problem, count)
        with _library_errors():
            eigenproblem = Eigenproblem(problem, density, prefix)
            values, vectors = eigenproblem.lowest(count)
    residuals = [eigenproblem.residual(*pair) for pair in zip(values, vectors, strict=True)]
    if not max(residuals) <= _LARGEST_RESIDUAL:
        raise BadInput(
            f"modes: an eigenpair has the relative residual {max(residuals):.2g}, "
            f"more than {_LARGEST_RESIDUAL:g}: the factors of MUMPS are not accurate enough"
        )
    frequencies = np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)
    mass, length = eigenproblem.mass, problem.length
    density = mass / length**problem.kinematics.volume_dimension
    shapes = [eigenproblem.shape(v, np.sqrt(mass) * length) for v in vectors]
    given = density, mass, length, frequencies.tolist(), residuals
    return VibrationModes(*given, shapes, watch.seconds)


def check(problem: Problem, count: int) -> None:
    """Check that ``count`` modes can be computed, before load steps or a solve. Collective.

    Raises
    ------
    BadInput
        On every rank: for fewer free dofs than modes, an unknown pressure, forces without an
        energy, inertia, or a cavity, or if SLEPc is missing.
    """
    # Torques on rigid parts have an energy about an axis, which a line search does not know.
    forces = [term for term in problem.terms if not term.has_energy and term is not problem.rigid]
    if forces or problem.regime.inertia:
        raise no_energy("modes", in_time=not forces)
    if not problem.is_assembled:
        raise BadInput("modes: the Hessian has a matrix of rank one: expected no cavity")
    if problem.saddle_point:
        raise BadInput(
            f"modes: element '{problem.element.name}' has a pressure without mass: "
            "take one with the displacement alone, P2P0 or Q1P0 where nu is close to 0.5"
        )
    free = problem.comm.allreduce(_free_basis(problem).getLocalSize()[1])
    if count > free:
        raise BadInput(f"modes: count = {count}: there are only {free} free degrees of freedom")
    with _library_errors():
        import_module("slepc4py.SLEPc")


@contextmanager
def _library_errors() -> Iterator[None]:
    """Turn ImportErrors of slepc4py, and errors of PETSc in the context, into BadInput."""
    try:
        yield
    except ImportError as error:
        raise BadInput(f"modes need slepc4py ({error}): install python3-slepc4py-real") from None
    except PETSc.Error as error:
        message = " ".join(str(error).split())
        raise BadInput(f"modes: PETSc with MUMPS failed: {message}") from None


def program_modes(
    problem: Problem, count: int, density: float | None, prefix: str, reason: str
) -> VibrationModes:
    """Check a program's arguments; return the modes: see `fem_snh.program_results.modes`."""
    check_whole("count", count, 1, INT32_MAX)
    if density is not None:
        check_number("density", density, 0.0, exclusive=True)
    elif not problem.regions or any(region.density is None for region in problem.regions):
        accepted = "a number > 0 [kg/m^3], or 'densities' of all materials of the problem"
        raise bad_value("density", None, accepted)
    check(problem, count)
    check_converged(reason, "vibration_modes")
    return lowest(problem, density, count, prefix + PREFIX)
