"""The lowest eigenfrequencies and their shapes about the present state, by SLEPc.

K phi = omega^2 M phi over the free degrees of freedom, K the exact Hessian of the energy, M the
consistent mass matrix. Krylov-Schur on (K - s M)^-1 with a shift s below every eigenvalue, so that
K - s M is positive definite also where K is not: in a free body, or in an unstable state. A Krylov
method can miss a copy of a multiple eigenvalue (the six zeros of a free body, the pairs of a
symmetric one); how many there are below the highest one found is counted by Sylvester's law of
inertia in a factorisation, and those that are missing are searched for in the complement.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from time import perf_counter
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.fem.problem import Problem
from fem_snh.fem.terms import mass_matrix

#: Shift, in units of the eigenvalues' scale E / (density length^2).
_SHIFT = 1e-2
#: Relative distance of the counted bound from the highest eigenvalue found.
_GAP = 1e-5


@dataclass
class Modes:
    """The lowest modes of a problem, in ascending order.

    frequencies : omega / (2 pi) [Hz]; negative where omega^2 is: the state is unstable that way.
    residuals : ||K phi - omega^2 M phi|| / ((|omega^2| + E / (density length^2)) ||M phi||).
    shapes : vectors like the problem's x [m], phi.M phi = mass length^2, the largest
        component positive.
    """

    problem: Problem
    density: float
    mass: float
    frequencies: list[float]
    residuals: list[float]
    shapes: list[PETSc.Vec]
    seconds: float

    @property
    def record(self) -> dict[str, Any]:
        """What run.json says of them."""
        return {
            "density": self.density,
            "mass": self.mass,
            "length": self.problem.length,
            "frequencies": self.frequencies,
            "residuals": self.residuals,
        }


def lowest(problem: Problem, density: float, count: int, prefix: str = "snh_modes_") -> Modes:
    """The ``count`` lowest modes about ``problem.x``, for a density [kg/m^3]. Collective.

    PETSc's options are under ``prefix``: ``-snh_modes_eps_monitor``, ``-snh_modes_eps_tol``...

    Raises BadInput, on every rank, if there are fewer free degrees of freedom than modes, SLEPc is
    missing, or it does not converge.
    """
    start, assembling = perf_counter(), problem.seconds["assemble"]
    check(problem, count)
    with _explained():
        pencil = _Pencil(problem, density, prefix)
        values, vectors = pencil.lowest(count)
    problem.seconds["assemble"] = assembling  # that of the load steps; this is the modes' time
    frequencies = np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)
    mass = density * problem.length**3
    return Modes(
        problem,
        density,
        mass,
        frequencies.tolist(),
        [pencil.residual(*pair) for pair in zip(values, vectors, strict=True)],
        [pencil.full(v, np.sqrt(mass) * problem.length) for v in vectors],
        perf_counter() - start,
    )


def check(problem: Problem, count: int) -> None:
    """What can be said before the load steps. Collective.

    Raises BadInput, on every rank, if there are fewer free degrees of freedom than modes, a
    pressure is unknown, or SLEPc is missing.
    """
    if problem.saddle_point:
        raise BadInput(
            f"modes: element '{problem.element.name}' has a pressure without mass: "
            "take one with the displacement alone, P2P0 or Q1P0 where nu is close to 0.5"
        )
    free = problem.x.getLocalSize() - len(problem.constrained_dofs)
    free = problem.comm.allreduce(free)
    if count > free:
        raise BadInput(f"modes: count = {count}: there are only {free} free degrees of freedom")
    with _explained():
        import_module("slepc4py.SLEPc")


class _Pencil:
    """K and M over the free degrees of freedom."""

    def __init__(self, problem: Problem, density: float, prefix: str) -> None:
        self._x, self._comm, self._prefix = problem.x, problem.comm, prefix
        self.scale = problem.material.expression.E / (density * problem.length**2)
        owned = problem.x.getLocalSize()
        self._free = np.delete(np.arange(owned), problem.constrained_dofs)
        first = problem.x.getOwnershipRange()[0]
        rows = PETSc.IS().createGeneral((first + self._free).astype(PETSc.IntType), problem.comm)
        problem.jacobian(problem.x, "exact")
        self.K = problem.A.createSubMatrix(rows, rows)
        self.M = mass_matrix(problem.V, density).createSubMatrix(rows, rows)
        for A in (self.K, self.M):
            A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.size = int(self.K.getSize()[0])

    def lowest(self, count: int) -> tuple[np.ndarray, list[PETSc.Vec]]:
        """The lowest eigenvalues [1/s^2] and their vectors, v.M v = 1."""
        shift = -_SHIFT * self.scale
        while below := self._below(shift):
            shift *= 10
            if abs(shift) > 1e20 * self.scale:
                raise BadInput(f"modes: the state has {below} eigenvalues without bound")
        found: list[tuple[float, PETSc.Vec]] = []
        missing = count
        while missing > 0 and len(found) < self.size:
            found += self._solve(shift, min(missing, self.size - len(found)), found)
            found.sort(key=lambda pair: pair[0])
            # All there are, if a count comes to the same just below the highest of those wanted.
            bound = found[min(count, len(found)) - 1][0]
            bound -= _GAP * (bound - shift)
            missing = self._below(bound) - sum(value < bound for value, _ in found)
            missing = max(missing, count - len(found))
        return np.array([value for value, _ in found[:count]]), [v for _, v in found[:count]]

    def _shifted(self, shift: float) -> PETSc.Mat:
        A = self.K.copy()
        A.axpy(-shift, self.M)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return A

    def _factored(self, ksp: PETSc.KSP, A: PETSc.Mat) -> PETSc.Mat:
        """Make ``ksp`` solve with A by MUMPS's factors L D L^T, and return these."""
        ksp.setOperators(A)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        factors.setMumpsIcntl(13, 1)  # the last front on one rank: inertia is counted there, too
        factors.setMumpsIcntl(24, 1)  # which PETSc wants for counting
        factors.setMumpsIcntl(14, 50)  # [%] more memory than estimated: pivoting needs some
        pc.setUp()
        if factors.getMumpsInfog(1) < 0:
            raise BadInput(f"modes: MUMPS failed with INFOG(1) = {factors.getMumpsInfog(1)}")
        return factors

    def _below(self, bound: float) -> int:
        """How many eigenvalues are below ``bound``."""
        ksp = PETSc.KSP().create(self._comm)
        return int(self._factored(ksp, self._shifted(bound)).getInertia()[0])

    def _solve(
        self, shift: float, count: int, known: list[tuple[float, PETSc.Vec]]
    ) -> list[tuple[float, PETSc.Vec]]:
        """``count`` or more eigenpairs nearest to ``shift``, M-orthogonal to those known."""
        from slepc4py import SLEPc

        eps = SLEPc.EPS().create(self._comm)
        eps.setOptionsPrefix(self._prefix)
        eps.setOperators(self.K, self.M)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
        eps.setDimensions(count)
        eps.setTolerances(1e-12, 1000)
        eps.setTarget(shift)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        if known:
            eps.setDeflationSpace([v for _, v in known])
        st = eps.getST()
        st.setType(SLEPc.ST.Type.SINVERT)
        st.setShift(shift)
        ksp = st.getKSP()
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.getPC().setType(PETSc.PC.Type.CHOLESKY)
        ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        eps.setFromOptions()
        eps.solve()
        converged = eps.getConverged()
        if converged < count:
            raise BadInput(
                f"modes: SLEPc found {converged} of {count} eigenvalues "
                f"(reason {eps.getConvergedReason()}): try -{self._prefix}eps_max_it, -eps_ncv"
            )
        return [self._pair(eps, i) for i in range(converged)]

    def _pair(self, eps: Any, i: int) -> tuple[float, PETSc.Vec]:
        """The i-th eigenpair of a solve, v.M v = 1; the value is Rayleigh's quotient."""
        v, w = self.K.createVecs()
        eps.getEigenvector(i, v)
        self.M.mult(v, w)
        v.scale(1 / np.sqrt(v.dot(w)))
        self.K.mult(v, w)
        return float(v.dot(w)), v

    def residual(self, value: float, v: PETSc.Vec) -> float:
        """As `Modes.residuals` has it."""
        r, w = self.K.createVecs()
        self.K.mult(v, r)
        self.M.mult(v, w)
        size = (abs(value) + self.scale) * w.norm()
        r.axpy(-value, w)
        return float(r.norm() / size)

    def full(self, v: PETSc.Vec, factor: float) -> PETSc.Vec:
        """``v`` times ``factor`` on all degrees of freedom, zero where they are prescribed."""
        x = self._x.duplicate()
        x.set(0.0)
        high, low = v.max()[1], v.min()[1]
        sign = -1.0 if -low > high * (1 + 1e-6) else 1.0
        x.array[self._free] = sign * factor * v.array_r
        return x


@contextmanager
def _explained() -> Iterator[None]:
    """Missing or failing libraries in one line."""
    try:
        yield
    except ImportError as error:
        raise BadInput(f"modes need slepc4py ({error}): install python3-slepc4py-real") from None
    except PETSc.Error as error:
        what = " ".join(str(error).split())
        raise BadInput(f"modes: PETSc with MUMPS failed: {what}") from None
