"""The elastic energy: value, derivative and filtered second derivative.

Calls the compiled cell loops of `fem_snh.kernels` on dolfinx spaces, with PETSc vectors and
matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.choices import EIGENSOLVERS, FILTERS
from fem_snh.errors import BadInput, choose, on_root
from fem_snh.fem.assembled_matrix import BlockMatrix
from fem_snh.fem.element_tables import element_tables
from fem_snh.fem.elements import Element
from fem_snh.fem.numbering import MixedDofMap, dof_map
from fem_snh.kernels import build
from fem_snh.kernels.cell_loops import CellLoops, cell_loops_source
from fem_snh.kernels.element_energy import element_energy
from fem_snh.kernels.pointwise import Material

Array = npt.NDArray[Any]


class Elastic:
    r"""The elastic energy of a material on a finite element space, and its derivatives. Collective.

    .. math:: E(u) = \int_\Omega \psi(I + \nabla u) \, \mathrm{d}V

    Rows and columns of the Hessian that belong to constrained dofs are zero but for one positive
    number on the diagonal, the same for all: the mean of the free diagonal entries of the first
    Hessian.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    element : Element
        Quadrature and volume treatment.
    material : Material
        The energy density psi.
    constrained : (local nodes, 3) bool, optional
        Constrained components of the displacement, ghost nodes included. Default: none.
    Q : dolfinx function space, optional
        The space of an unknown pressure, in which the energy is stationary, not minimal.
    pressure_scale : float, optional
        Unit of the pressure unknown [Pa/m].

    Attributes
    ----------
    matrix : PETSc.Mat
        The matrix that `jacobian` fills.
    loops : CellLoops
        The compiled loops over this rank's cells.
    element_energy : ElementEnergy
        The energy density, with the volume term apart where the element treats it separately.
    has_energy : bool
        False for a material that is defined by a stress.
    jit_seconds : float
        Time spent generating and compiling C.
    shape : tuple of int
        (cells of this rank, nodes per cell).

    Raises
    ------
    BadInput
        On every rank, for a material that the element's volume treatment does not support.
    """

    name = "elastic"
    depends_on_load = False

    def __init__(
        self,
        V: Any,
        element: Element,
        material: Material,
        constrained: Array | None = None,
        Q: Any = None,
        pressure_scale: float = 1.0,
    ) -> None:
        self._comm = V.mesh.comm
        tables = element_tables(V, element, Q, pressure_scale)
        start = perf_counter()
        self.element_energy = element_energy(material.expression, element.volume)
        self.has_energy = material.expression.has_energy
        self._material_name = material.name
        source = cell_loops_source(self.element_energy, tables)
        library = on_root(self._comm, build.library, source)
        self.jit_seconds = perf_counter() - start
        self.loops = CellLoops(library, self.element_energy, tables)
        self.shape = tables.nodes.shape[0], tables.nodes.shape[1]

        owned, ghosts = _dolfinx.num_nodes(V)
        if constrained is None:
            constrained = np.zeros((owned + ghosts, 3), dtype=bool)
        self._constrained_dofs = np.flatnonzero(constrained[:owned])
        self._num_u = 3 * owned
        spaces = [dof_map(V, 3)] if Q is None else [dof_map(V, 3), dof_map(Q, 1)]
        self._block_matrix = BlockMatrix(MixedDofMap(self._comm, spaces))
        self.matrix = self._block_matrix.mat
        self._target = self._create_target(constrained, tables.nodes)
        self._constrained_diagonal: float | None = None
        self._diagonal_vec: PETSc.Vec | None = None

    def _create_target(self, constrained: Array, cell_nodes: Array) -> Any:
        """Return the C struct that tells the cell loops where element matrices are added."""
        strides, positions = self._block_matrix.row_strides, self._block_matrix.block_positions
        free = np.where(constrained, 0.0, 1.0)
        constrained_cells: Array = np.any(constrained[cell_nodes], axis=(1, 2)).astype(np.uint8)
        # The struct has pointers to these arrays, which must live as long.
        self._target_arrays = (*strides, positions, free, constrained_cells)
        return self.loops.target(strides, positions, free, constrained_cells)

    def set_load(self, load: float) -> None:
        """Do nothing: the elastic energy does not depend on the load."""

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy [J]; +inf where u is outside the energy's domain. Collective.

        Raises
        ------
        BadInput
            If the material is defined by a stress and has no energy.
        """
        if not self.has_energy:
            raise BadInput(f"material '{self._material_name}' has no energy, only a stress")
        local = self.loops.energy(_local(u), _if_any(_local, p))
        return float(self._comm.allreduce(local, op=MPI.SUM))

    def add_residual(
        self,
        u: PETSc.Vec,
        p: PETSc.Vec | None,
        r_u: PETSc.Vec,
        r_p: PETSc.Vec | None,
    ) -> None:
        """Add dE/du [N] and dE/dp to all entries of ``r_u`` and ``r_p``, ghosts included."""
        self.loops.residual(_local(u), _writable(r_u), _if_any(_local, p), _if_any(_writable, r_p))

    def jacobian(
        self,
        u: PETSc.Vec,
        p: PETSc.Vec | None = None,
        filter: str = "exact",
        eigensolver: str = EIGENSOLVERS[0],
    ) -> int:
        """Fill ``matrix`` with the filtered Hessian d2E/du2 [N/m]. Collective.

        Parameters
        ----------
        u, p : PETSc.Vec
            Ghosted displacement [m] and pressure; the ghosts must be current.
        filter : {"exact", "clamp", "abs"}
            What becomes of negative eigenvalues at each quadrature point.
        eigensolver : str
            Solver for the 3x3 scaling block, one of `fem_snh.choices.EIGENSOLVERS`.

        Returns
        -------
        int
            The number of filtered quadrature points, on all ranks.
        """
        filter_index = FILTERS.index(choose("filter", filter, FILTERS))
        solver_index = EIGENSOLVERS.index(choose("eigensolver", eigensolver, EIGENSOLVERS))
        with self._block_matrix.value_addresses() as addresses:
            for k, address in enumerate(addresses):
                self._target.values[k] = self.loops.address(address)
            filtered = self.loops.jacobian(
                _local(u), filter_index, solver_index, self._target, _if_any(_local, p)
            )
        self._add_constrained_diagonal()
        return int(self._comm.allreduce(filtered))

    @property
    def constrained_diagonal(self) -> float | None:
        """The diagonal entry of constrained dofs [N/m]; None before the first Hessian."""
        return self._constrained_diagonal

    def set_constrained_diagonal(self, value: float | None) -> None:
        """Set the diagonal entry of constrained dofs [N/m] from the next Hessian on.

        With None the next Hessian determines it.
        """
        self._constrained_diagonal, self._diagonal_vec = value, None

    def _add_constrained_diagonal(self) -> None:
        """Add the diagonal entry of constrained dofs, where the matrix is zero so far."""
        if self._diagonal_vec is None:
            self._diagonal_vec = self.matrix.getDiagonal()
            values = self._diagonal_vec.array
            if self._constrained_diagonal is None:
                free = np.delete(values[: self._num_u], self._constrained_dofs)
                local = np.array([np.abs(free).sum(), len(free)])
                total, count = self._comm.allreduce(local)
                self._constrained_diagonal = float(total / max(count, 1)) or 1.0
            values[:] = 0.0
            values[self._constrained_dofs] = self._constrained_diagonal
        self.matrix.setDiagonal(self._diagonal_vec, addv=PETSc.InsertMode.ADD)

    def cell_fields(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> dict[str, Array]:
        """Return, for each cell of this rank, the fields of `Problem.cell_fields`."""
        return self.loops.fields(_local(u), _if_any(_local, p))


def _local(vector: PETSc.Vec) -> Array:
    """Return a ghosted vector's local values to read, ghosts included."""
    with vector.localForm() as local:
        return np.asarray(local.array_r)


def _writable(vector: PETSc.Vec) -> Array:
    """Return a ghosted vector's local values to write, ghosts included."""
    with vector.localForm() as local:
        return np.asarray(local.array)


def _if_any(values: Callable[[PETSc.Vec], Array], vector: PETSc.Vec | None) -> Array | None:
    """Return the values of a vector that only an unknown pressure has."""
    return None if vector is None else values(vector)
