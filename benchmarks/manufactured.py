"""A manufactured solution with large shears, a small change of volume and a matching load.

x is displaced along z, y along x and z along y by waves; these are shears, so J = 1 exactly. A
smooth field of size mu/lam then changes the volume, so that the pressure lam (J - 1) varies and
stays bounded as nu -> 1/2. The load is the virtual work of the exact stress, b(v) = int P : grad v,
which is valid for any free part of the boundary. Each face is free to slide along one axis: with
fully constrained faces no displacement would determine the pressure of a tetrahedron in a corner at
nu = 1/2. The top is free along its normal: an incompressible body in a closed box has in general no
solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isinf
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx, solver
from fem_snh.assembly.elements import Element
from fem_snh.assembly.regions import Filling
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material
from fem_snh.linalg.direct_solver import set_direct_solver
from fem_snh.mesh import mesh
from fem_snh.problem.definition import Definition
from fem_snh.problem.problem import Problem
from fem_snh.terms.term import Term

#: Quadrature degree of errors and load: enough for the waves on cells of size 1/2.
DEGREE = 7
FACES = {
    "left": ("x", "y"),
    "right": ("x", "y"),
    "front": ("y", "z"),
    "back": ("y", "z"),
    "bottom": ("z", "x"),
    "top": ("x",),
}


def exact(X: Any, sin: Callable[[Any], Any], shear: Any, swell: Any) -> tuple[Any, Any, Any]:
    """Return the displacement at X = (x, y, z), numbers or UFL; swell = 0 gives J = 1."""
    x = X[0] + shear * sin(2 * X[1] + 3 * X[2])
    y = X[1] + shear * sin(3 * X[2] - 2 * x)
    z = X[2] + shear * sin(2 * x + 3 * y)
    waves = (sin(3 * X[0] + X[1]), sin(4 * X[1] - X[2]), sin(3 * X[2] + 2 * X[0]))
    return tuple(a + swell * w - b for a, w, b in zip((x, y, z), waves, X, strict=True))


def bent_cube(comm: MPI.Comm, cell: str, cells: int, bend: float) -> mesh.Mesh:
    """Return the unit cube with inner nodes moved by ``bend``: its cells are not affine."""
    made = mesh.generate(comm, "cube", cell, cells=cells)
    x = _dolfinx.geometry_x(made.domain)
    inside = 64 * (x * (1 - x)).prod(axis=1, keepdims=True)
    x += bend * inside * np.sin(x @ np.array([[1.0, 5, 2], [4, 2, 3], [3, 1, 7]]))
    return made


def solve_to_rounding(problem: Problem, tolerance: float = 1e-9) -> int:
    """Solve to rounding error with direct solvers and return the number of Newton iterations.

    The solver's line search works until the decrease of the energy is below its rounding error;
    undamped Newton steps then continue until the residual stops decreasing.

    Raises
    ------
    BadInput
        If the residual stays above ``tolerance`` E V^(2/3).
    """
    snes, most = solver.create(problem, globalization="linesearch"), 30
    snes.getPythonContext().options |= {"snes_scaled_tol": 1e-7, "snes_forcing_max": 0.0}
    ksp = snes.getKSP()
    set_direct_solver(ksp)
    x, r, d = problem.x, problem.x.duplicate(), problem.x.duplicate()
    its = 0
    if not problem.saddle_point:
        snes.solve(None, x)
        if snes.getConvergedReason() <= 0:
            raise BadInput(f"{problem.element.name}: {solver.converged_reason(snes)}")
        its = int(snes.getIterationNumber())
    problem.residual(x, r)
    norm, bound = r.norm(), tolerance * problem.force_scale
    for more in range(1, most):
        problem.jacobian(x, "exact")
        ksp.setOperators(problem.A)
        ksp.solve(r, d)
        x.axpy(-1.0, d)
        before = norm
        problem.residual(x, r)
        norm = r.norm()
        if norm <= bound and norm > before / 4:
            return its + more
    raise BadInput(f"{problem.element.name}: no equilibrium in {most} Newton iterations")


@dataclass
class _Boundary:
    group: str
    components: tuple[str, ...]
    displacement: Callable[[Any, float], Any]


class Load(Term):
    """The potential -f . u of the virtual work of a stress field, as an energy term."""

    name = "load"

    def __init__(self, V: Any, P: Any) -> None:
        self._force = _dolfinx.create_vector(V)
        dx = ufl.dx(metadata={"quadrature_degree": DEGREE})
        form = ufl.inner(P, ufl.grad(ufl.TestFunction(V))) * dx
        _dolfinx.assemble_vector(self._force, _dolfinx.form(form))

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None) -> float:
        """Return -f . u [J]."""
        return -float(self._force.dot(u))

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Subtract f [N] from the owned entries of ``r_u``."""
        r_u.array[:] -= self._force.array_r

    def add_hessian(self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: Any) -> int:
        """Add nothing: the potential is linear."""
        return 0


class Manufactured:
    """The manufactured solution on a cube of Stable Neo-Hookean with E = 1. Collective.

    Parameters
    ----------
    shear : float
        Amplitude of the waves; 0.1 gives stretches from 0.7 to 1.4.
    swell : float
        Size of the change of volume, in units of mu/lam.
    bend : float
        Distance by which inner nodes of the mesh are moved.
    """

    def __init__(
        self,
        element: Element,
        cells: int,
        nu: float = 0.3,
        shear: float = 0.1,
        swell: float = 0.1,
        bend: float = 0.02,
        comm: MPI.Comm = MPI.COMM_SELF,
    ) -> None:
        self.element, self.nu = element, nu
        solid = material("stable_neo_hookean", E=1.0, nu=nu, barrier=False)
        mu, lam = solid.expression.values
        self.shear, self.swell = shear, 0.0 if isinf(lam) else swell * mu / lam
        faces = [_Boundary(face, axes, self._displacement) for face, axes in FACES.items()]
        body = bent_cube(comm, element.cell, cells, bend)
        self.problem = Definition(body, element, [Filling(solid)], faces).problem()
        numbers = {"shear": shear, "swell": self.swell, "mu": mu, "lam": 0.0, "volume": 0.0}
        if isinf(lam):
            numbers["push"] = mu / 2
        else:
            numbers |= {
                "lam": lam,
                "volume": self.problem.elastic.parts[0].loops.constants.volume_stiffness,
                "push": 0.0,
            }
        self._constants = {
            name: _dolfinx.constant(body.domain, np.array(v)) for name, v in numbers.items()
        }
        self.u = self._exact()
        F, c = ufl.Identity(3) + ufl.grad(self.u), self._constants
        self._J = ufl.det(F)
        # The factor of cof F: lam (J - 1) - mu; at nu = 0.5 a wave minus mu.
        cofactor = self._J * ufl.inv(F).T
        push = c["lam"] * (self._J - 1) - c["mu"] + self._wave()
        self.problem.terms.append(Load(self.problem.V, c["mu"] * F + push * cofactor))

    def _displacement(self, X: Any, load: float) -> Any:
        return np.stack(exact(X.T, np.sin, self.shear, self.swell), axis=1)

    def _exact(self) -> Any:
        c = self._constants
        X = _dolfinx.coordinates(self.problem.domain)
        return ufl.as_vector(exact(X, ufl.sin, c["shear"], c["swell"]))

    def _wave(self) -> Any:
        X = _dolfinx.coordinates(self.problem.domain)
        return self._constants["push"] * ufl.sin(2 * X[0] - X[1] + 3 * X[2])

    def pressure(self) -> Any:
        """Return the exact pressure of Taylor-Hood elements in UFL: U'(J), at nu = 0.5 the wave."""
        return self._constants["volume"] * (self._J - 1) + self._wave()

    def solve(self) -> int:
        """Solve from the nodal values of the exact solution; return the Newton iterations.

        Raises
        ------
        BadInput
            If Newton's method does not converge.
        """
        p = self.problem
        u = self._displacement(p.coordinates, 1.0)
        p.x.array[: u.size] = u.ravel()
        p.set_load(1.0)
        p.prescribe(p.x)
        return solve_to_rounding(p)

    def errors(self) -> list[float]:
        """Return ||u - u_h||, ||grad (u - u_h)|| and, for Taylor-Hood, ||p - p_h|| in L2."""
        wrong = self.problem.u - self.u
        found = [self._norm(wrong), self._norm(ufl.grad(wrong))]
        if self.problem.saddle_point:
            Q, values = self.problem.saddle_point.Q, self.problem.saddle_point.pressure()
            p = _dolfinx.function(Q, "p")
            p.x.array[:] = values
            found.append(self._norm(p - self.pressure()))
        return found

    def _norm(self, field: Any) -> float:
        dx = ufl.dx(metadata={"quadrature_degree": DEGREE})
        form = _dolfinx.form(ufl.inner(field, field) * dx)
        return float(np.sqrt(_dolfinx.assemble_scalar(form)))
