r"""Stresses and strains of a problem's state at the quadrature points, and their means over cells.

With the displacement gradient H, F = I + H, J = det F and the first Piola-Kirchhoff stress P
(Bonet & Wood 2008, chapters 4 and 5):

.. math:: \sigma = \frac{1}{J} P F^T, \qquad E = \tfrac12 (H + H^T + H^T H) .

P is the stress of the element: with mean dilatation or an unknown pressure it contains the pressure
of the element, not that of the pointwise energy.
"""

from __future__ import annotations

from functools import cached_property

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.errors import choose, on_root
from fem_snh.fem.problem import Problem
from fem_snh.kernels import build
from fem_snh.kernels.stress_loops import StressLoops, stress_loops_source
from fem_snh.kernels.svd_eigen import eigen3, svd

Array = npt.NDArray[np.float64]


class PointState:
    """Strains and stresses at quadrature points; each is computed when it is first used.

    Parameters
    ----------
    weights : (cells, points)
        Quadrature weights in the reference configuration [m^3].
    H : (cells, points, 3, 3)
        Displacement gradients du_i/dX_j.
    P : (cells, points, 3, 3)
        First Piola-Kirchhoff stresses [Pa].

    Attributes
    ----------
    weights, H, P
        The parameters.
    """

    def __init__(self, weights: Array, H: Array, P: Array) -> None:
        self.weights, self.H, self.P = weights, H, P

    @cached_property
    def F(self) -> Array:
        """Deformation gradients, (cells, points, 3, 3)."""
        return self.H + np.eye(3)

    @cached_property
    def cauchy_stress(self) -> Array:
        """Cauchy stresses [Pa], (cells, points, 3, 3); NaN where J = 0."""
        F, a, b, c = self.F, *(self.F[..., i] for i in range(3))
        J = sum(a[..., i] * (b[..., j] * c[..., k] - b[..., k] * c[..., j]) for i, j, k in _CYCLES)
        return _products(self.P, F) / np.where(J == 0, np.nan, J)[..., None, None]

    @cached_property
    def von_mises(self) -> Array:
        """Von Mises stresses [Pa], (cells, points)."""
        s = self.cauchy_stress
        normal = [(s[..., i, i] - s[..., j, j]) ** 2 for i, j in _PAIRS]
        shear = [s[..., i, j] ** 2 for i, j in _PAIRS]
        return np.sqrt(0.5 * sum(normal) + 3 * sum(shear))

    @cached_property
    def hydrostatic_stress(self) -> Array:
        """Means of the three normal stresses [Pa], (cells, points); positive in tension."""
        return np.trace(self.cauchy_stress, axis1=-2, axis2=-1) / 3

    @cached_property
    def principal_stresses(self) -> Array:
        """Eigenvalues of the Cauchy stress [Pa], descending, (cells, points, 3)."""
        return eigen3(self.cauchy_stress, "jacobi")[0]

    @property
    def pk1_stress(self) -> Array:
        """First Piola-Kirchhoff stresses [Pa], (cells, points, 3, 3)."""
        return self.P

    @cached_property
    def green_lagrange_strain(self) -> Array:
        """Green-Lagrange strains, (cells, points, 3, 3); accurate also where they are small."""
        H, transposed = self.H, np.swapaxes(self.H, -1, -2)
        return 0.5 * (H + transposed + _products(transposed, transposed))

    @cached_property
    def principal_stretches(self) -> Array:
        """Signed singular values of F, descending, (cells, points, 3)."""
        return svd(self.F)[1]

    def values(self, name: str) -> Array:
        """Return one of `POINT_FIELDS`, (cells, points, ...)."""
        found: Array = getattr(self, choose("field", name, POINT_FIELDS))
        return found

    def mean(self, name: str) -> Array:
        """Return the mean of a field over the reference volume of each cell, (cells, ...)."""
        weights = self.weights / self.weights.sum(axis=1, keepdims=True)
        return np.asarray(np.einsum("cq,cq...->c...", weights, self.values(name)))


def _products(A: Array, B: Array) -> Array:
    """Return A B^T, (..., 3, 3); by components it is several times as fast as numpy's matmul."""
    out = np.empty((3, 3, *A.shape[:-2]))
    for i in range(3):
        for k in range(3):
            out[i, k] = sum(A[..., i, j] * B[..., k, j] for j in range(3))
    return np.moveaxis(out, (0, 1), (-2, -1))


#: Even permutations and pairs of the axes.
_CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
_PAIRS = ((0, 1), (1, 2), (2, 0))
#: Fields that `PointState` has.
POINT_FIELDS = (
    "cauchy_stress", "von_mises", "principal_stresses", "hydrostatic_stress", "pk1_stress",
    "green_lagrange_strain", "principal_stretches",
)  # fmt: skip


class StressFields:
    """Stresses and strains of a problem; compiles its kernels. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._num_cells = problem.elastic.shape[0]
        self._parts = []
        for part in problem.elastic.parts:
            library = on_root(problem.comm, build.library, stress_loops_source(part.loops))
            self._parts.append((part.region.cells, StressLoops(library, part.loops)))

    def evaluate(self, x: PETSc.Vec) -> PointState:
        """Return the strains and stresses of this rank's cells at a state. Collective."""
        u, p = self._problem.split(x)
        arrays = _local_values(u), None if p is None else _local_values(p)
        found = [(cells, loops.evaluate(*arrays)) for cells, loops in self._parts]
        if len(found) == 1:
            return PointState(*found[0][1])
        merged = [np.empty((self._num_cells, *a.shape[1:])) for a in found[0][1]]
        for cells, values in found:
            for whole, part in zip(merged, values, strict=True):
                whole[cells] = part
        return PointState(*merged)


def _local_values(vector: PETSc.Vec) -> Array:
    """Return a ghosted vector's local values, ghosts included."""
    with vector.localForm() as local:
        return np.asarray(local.array_r)
