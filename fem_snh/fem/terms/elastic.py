"""The elastic energy of a displacement: value, derivative and filtered second derivative.

The compiled cell loops of `fem_snh.kernels` on a dolfinx space, into PETSc vectors and matrices.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.choices import EIGENSOLVERS, FILTERS
from fem_snh.errors import choose, on_root
from fem_snh.fem.assembled_matrix import BlockMatrix
from fem_snh.fem.elements import Element
from fem_snh.fem.numbering import Layout
from fem_snh.kernels import build
from fem_snh.kernels.cell_loops import CellLoops, ElementTables, cell_loops_source
from fem_snh.kernels.element_energy import element_energy
from fem_snh.kernels.pointwise import Material

Array = npt.NDArray[Any]


def tables(V: Any, element: Element, Q: Any = None, scale: float = 1.0) -> ElementTables:
    """Basis, geometry and quadrature of ``element`` on this rank's cells of the space V.

    Q is the pressure's space if it has one, its basis functions multiplied by ``scale``.
    """
    domain = V.mesh
    points, weights = _dolfinx.quadrature(element.cell, element.quadrature)
    made = (
        _dolfinx.node_dofs(V),
        _dolfinx.geometry_dofs(domain),
        _dolfinx.geometry_x(domain),
        _dolfinx.tabulate(V, points),
        _dolfinx.tabulate_geometry(domain, points),
        weights,
        element.volume,
    )
    if Q is None:
        return ElementTables(*made)
    basis = _dolfinx.tabulate_values(Q, points)
    return ElementTables(*made, _dolfinx.node_dofs(Q), scale * basis)


class Elastic:
    """The elastic energy of ``material`` on the space V [J], and its derivatives. Collective.

    ``free`` (local nodes, 3) is 0 where the displacement is prescribed: rows and columns of the
    Jacobian are zero there but for a positive diagonal. It is set before `create_matrix`.

    ``diagonal`` is that positive number [N/m], of the first Jacobian; None before there is one.

    With a space Q of an unknown pressure (in units of ``scale`` [Pa]) the energy is stationary in
    it, not least; ``pressure`` and ``residual_pressure`` are then its ghosted vectors.

    Raises BadInput for a material that the element's volume treatment cannot take.
    """

    name = "elastic"

    def __init__(
        self, V: Any, element: Element, material: Material, Q: Any = None, scale: float = 1.0
    ) -> None:
        self.V, self.comm = V, V.mesh.comm
        made = tables(V, element, Q, scale)
        start = perf_counter()
        self.law = law = element_energy(
            material.expression, element.volume
        )  # codegen, compilation's share
        path = on_root(self.comm, build.library, cell_loops_source(law, made))  # compiled once
        self.jit_seconds = perf_counter() - start
        self.loops = CellLoops(path, law, made)
        self._nodes = made.nodes
        self._owned, ghosts = _dolfinx.num_nodes(V)
        self.free = np.ones((self._owned + ghosts, 3))
        self.pressure: PETSc.Vec | None = None
        self.residual_pressure: PETSc.Vec | None = None
        self._target: Any = None
        self.diagonal: float | None = None
        self._held: PETSc.Vec | None = None  # that number where the displacement is prescribed

    def create_matrix(self, layout: Layout) -> PETSc.Mat:
        """The matrix that `jacobian` fills, made once. Collective."""
        self._blocks = BlockMatrix(layout)
        constrained = (self.free[self._nodes] == 0).any(axis=(1, 2)).astype(np.uint8)
        self._arrays = [*self._blocks.strides, self._blocks.position, self.free, constrained]
        self._target = self.loops.target(self._blocks.strides, *self._arrays[3:])
        return self._blocks.petsc

    @property
    def shape(self) -> tuple[int, int]:
        """(cells of this rank, nodes of a cell)."""
        return self._nodes.shape[0], self._nodes.shape[1]

    def energy(self, u: PETSc.Vec) -> float:
        """The integral of psi [J]; +inf where u is outside the energy's domain."""
        with u.localForm() as local:
            return self.comm.allreduce(self.loops.energy(local.array_r, self._p()), op=MPI.SUM)

    def add_residual(self, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """r += dE/du [N], at ghost nodes too; u's ghosts must be current."""
        r_p = None if self.residual_pressure is None else _all(self.residual_pressure)
        with u.localForm() as local_u, r.localForm() as local_r:
            self.loops.residual(local_u.array_r, local_r.array, self._p(), r_p)

    def jacobian(
        self, u: PETSc.Vec, filter: str = "exact", eigensolver: str = EIGENSOLVERS[0]
    ) -> int:
        """Fill the matrix with the filtered d2E/du2 [N/m]; the number of points filtered."""
        which = FILTERS.index(choose("filter", filter, FILTERS))
        solver = EIGENSOLVERS.index(choose("eigensolver", eigensolver, EIGENSOLVERS))
        with u.localForm() as local, self._blocks.values() as addresses:
            for k, address in enumerate(addresses):
                self._target.values[k] = self.loops.address(address)
            negative = self.loops.jacobian(local.array_r, which, solver, self._target, self._p())
        self._set_diagonal()
        return int(self.comm.allreduce(negative))

    def _p(self) -> Array | None:
        return None if self.pressure is None else _all(self.pressure)

    def _set_diagonal(self) -> None:
        """A typical stiffness on the diagonal of prescribed components, which is zero."""
        A = self._blocks.petsc
        if self._held is None:
            self._held = A.getDiagonal()
            held = self.free[: self._owned].ravel() == 0
            mine = self._held.array[: len(held)]  # the displacement's; a pressure's come after
            if self.diagonal is None:
                free = mine[~held]
                total, count = self.comm.allreduce(np.array([np.abs(free).sum(), len(free)]))
                self.diagonal = float(total / max(count, 1)) or 1.0
            self._held.array[:] = 0.0
            self._held.array[: len(held)][held] = self.diagonal
        A.setDiagonal(self._held, addv=PETSc.InsertMode.ADD)

    def fields(self, u: PETSc.Vec) -> dict[str, Array]:
        """Per owned cell: volumes [m^3], smallest J, energy [J], smallest eigenvalue [Pa]."""
        with u.localForm() as local:
            return self.loops.fields(local.array_r, self._p())


def _all(vector: PETSc.Vec) -> Array:
    """A ghosted vector's values, ghosts included."""
    with vector.localForm() as local:
        return np.asarray(local.array)
