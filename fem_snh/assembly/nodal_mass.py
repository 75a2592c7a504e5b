r"""The mass matrix of a displacement space, as one number for each pair of nodes.

The components of the displacement have the same basis functions, so that the mass matrix is
:math:`m_{ab} I` for each pair of nodes a, b,

.. math:: m_{ab} = \int_\Omega \rho N_a N_b \, \mathrm{d}V .

In two dimensions the integral is over the whole turn of a body of revolution, or a unit thickness.
A rank keeps the sum over its own cells, rows of ghost nodes included: a product with a ghosted
vector needs no message, and is summed over the ranks together with the residuals of other terms.

`StoredMatrix` keeps an assembled matrix of any terms, to add multiples of it to a problem's matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.linalg.blas import daxpy
from scipy.sparse import csr_matrix

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh._petsc import aij_blocks, jacobi_cg, values_at
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.matrix_layout import MatrixLayout
from fem_snh.assembly.regions import Region, density_of
from fem_snh.choices import MASSES
from fem_snh.errors import BadInput, choose
from fem_snh.mesh.mesh import point_volumes

#: Relative tolerance of the mass matrix's linear solver, close to rounding.
_RTOL = 1e-13
#: Largest relative residual of the solution in the 2-norm, in which nodes of a small mass count
#: less than in the solver's preconditioned norm.
_LARGEST_RESIDUAL = 1e-9


class NodalMass:
    r"""The mass matrix of a body. Collective.

    ==============  ================================================================================
    ``consistent``  :math:`m_{ab}` as above
    ``lumped``      diagonal. Degree 1: the row sums of m. Degree 2: the diagonal of each cell's
                    matrix, scaled to the cell's mass, as sums of rows of tetrahedra are negative at
                    corners (Hinton, Rock & Zienkiewicz 1976)
    ==============  ================================================================================

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    regions : sequence of Region
        The cells and their densities rho [kg/m^3].
    kind : {"consistent", "lumped"}, optional
        Which mass matrix.
    kinematics : Kinematics, optional
        The kinematics of the displacement.

    Attributes
    ----------
    matrix : (local nodes, local nodes) scipy CSR matrix
        The sum of m [kg] over this rank's cells, ghost nodes included.
    num_owned : int
        Number of displacement dofs that this rank owns.
    total : float
        The body's mass [kg].

    Raises
    ------
    BadInput
        On every rank, for an unknown kind or a material without a density.
    """

    def __init__(
        self,
        V: FunctionSpace,
        regions: Sequence[Region],
        kind: str = MASSES[0],
        kinematics: Kinematics = SOLID,
    ) -> None:
        lumped = choose("time.mass", kind, MASSES) == "lumped"
        self._comm: MPI.Comm = V.mesh.comm
        self._components = kinematics.components
        self.num_owned = self._components * _dolfinx.num_nodes(V)[0]
        nodes, m = _dolfinx.node_dofs(V), _element_matrices(V, regions, kinematics.revolved)
        count, n = sum(_dolfinx.num_nodes(V)), nodes.shape[1]
        pair: Array = np.arange(nodes.size * n).reshape(len(nodes), n, n)
        if lumped:
            m, pair = _lumped(m, _dolfinx.degree(V)), np.diagonal(pair, axis1=1, axis2=2)
            rows = columns = nodes
        else:
            rows, columns = np.repeat(nodes, n, axis=1), np.tile(nodes, (1, n))
        keys = rows.ravel().astype(np.int64) * count + columns.ravel()
        keys, first, slots = np.unique(keys, return_index=True, return_inverse=True)
        values = np.bincount(slots.ravel(), weights=m.ravel(), minlength=len(keys))
        values = values.astype(np.float64)  # without cells numpy returns integers
        starts = np.searchsorted(keys, count * np.arange(count + 1, dtype=np.int64))
        pattern = (keys % count).astype(np.int32), starts.astype(np.int32)
        self.matrix = csr_matrix((values, *pattern), shape=(count, count))
        #: For each pair of nodes, its first index among the pairs (cells, n, n) of all cells.
        self._first, self._cell_nodes = pair.ravel()[first], n
        self._positions: tuple[MatrixLayout, Array] | None = None
        self.total = float(self._comm.allreduce(values.sum(), op=MPI.SUM))

    def add_points(self, masses: Array) -> None:
        """Add point masses [kg] at this rank's own nodes, (owned nodes,). Collective."""
        starts, columns = self.matrix.indptr, self.matrix.indices
        rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        own = np.flatnonzero((rows == columns) & (rows < len(masses)))
        self.matrix.data[own] += masses[rows[own]]
        self.total += float(self._comm.allreduce(float(masses.sum()), op=MPI.SUM))

    def apply(self, values: Array) -> Array:
        """Return this rank's part of the product of m and nodal values. Not collective.

        Parameters
        ----------
        values : (local dofs,)
            Nodal values with updated ghosts.

        Returns
        -------
        (local dofs,)
            The product is the sum over the ranks, by `add_ghosts`.
        """
        return np.asarray(self.matrix @ values.reshape(-1, self._components)).ravel()

    def dot(self, a: Array, b: Array) -> float:
        """Return a . (m b) for nodal values (local dofs,) with updated ghosts. Collective."""
        return float(self._comm.allreduce(float(a @ self.apply(b)), op=MPI.SUM))

    def add_to(self, target: BlockMatrix, factor: float) -> None:
        """Add ``factor`` times the matrix, inside of `BlockMatrix.adding`.

        Rows and columns of constrained dofs are left out.
        """
        if self._positions is None or self._positions[0] is not target.layout:
            n = self._cell_nodes
            positions = np.ascontiguousarray(target.block_positions[:, :n, :n]).ravel()
            self._positions = target.layout, positions[self._first]
        pattern = self.matrix.indptr, self.matrix.indices
        target.add_node_pairs(pattern, self._positions[1], factor, self.matrix.data)

    def assemble(self, matrix: BlockMatrix) -> None:
        """Overwrite a problem's matrix with the mass matrix of the free dofs. Collective.

        `BlockMatrix.constrained_diagonal` is that of the masses here, and restored afterwards.
        """
        kept, half = matrix.constrained_diagonal, matrix.layout.half
        matrix.set_constrained_diagonal(None)
        if half:
            half.unit, unit = self.total, half.unit
        with matrix.adding():
            self.add_to(matrix, 1.0)
        if half:
            half.unit = unit
        matrix.set_constrained_diagonal(kept)

    def solve(self, matrix: BlockMatrix, project: Callable[[Array], None], force: Array) -> Array:
        """Return the solution of m a = force over the free dofs, zero at constrained ones.

        Collective.

        Parameters
        ----------
        matrix : BlockMatrix
            A problem's matrix, which is overwritten.
        project : callable
            Sets this rank's part of a vector to zero along constrained directions, in place.
        force : (owned dofs,)
            The right-hand side [N].

        Returns
        -------
        (owned dofs,)
            The accelerations [m/s^2].

        Raises
        ------
        BadInput
            If the linear solver leaves a large residual.
        """
        self.assemble(matrix)
        ksp = jacobi_cg(self._comm, rtol=_RTOL, atol=0.0)
        ksp.setOperators(matrix.mat)
        a, b = matrix.mat.createVecs()
        b.set(0.0)
        b.array[: self.num_owned] = force
        project(b.array)
        ksp.solve(b, a)
        # The residual decides, not the KSP's converged reason: the solution is used as it is.
        residual = b - matrix.mat * a
        if not residual.norm() <= _LARGEST_RESIDUAL * b.norm():
            size = residual.norm() / b.norm()
            raise BadInput(
                f"mass matrix: PETSc's CG left a relative residual of {size:.2g} "
                f"(reason {ksp.getConvergedReason()})"
            )
        return np.array(a.array_r[: self.num_owned])


def _element_matrices(V: FunctionSpace, regions: Sequence[Region], revolved: bool) -> Array:
    """Return the consistent mass matrices [kg] of this rank's cells, (cells, nodes, nodes)."""
    domain = V.mesh
    rho = np.zeros(len(_dolfinx.node_dofs(V)))
    for region in regions:
        rho[region.cells] = region.filled(density_of(region, "the mass"))
    # det(dx/dX) has degree 3 (g - 1) on tetrahedra and 3 g - 1 in each direction on hexahedra, and
    # less on their faces; the radius has degree g.
    g = _dolfinx.geometry_degree(domain)
    simplex = _dolfinx.cell_name(domain) in ("tetrahedron", "triangle")
    degree = 2 * _dolfinx.degree(V) + (3 * (g - 1) if simplex else 3 * g - 1) + g * revolved
    points, _ = _dolfinx.quadrature(_dolfinx.cell_name(domain), degree)
    weights = rho[:, None] * point_volumes(domain, degree, revolved)
    N = _dolfinx.tabulate_values(V, points)
    products = (N[:, :, None] * N[:, None, :]).reshape(len(N), -1)
    return np.asarray(weights @ products).reshape(-1, N.shape[1], N.shape[1])


def _lumped(m: Array, degree: int) -> Array:
    """Return the diagonals of lumped element matrices, (cells, nodes)."""
    if degree == 1:
        return np.asarray(m.sum(axis=2))
    diagonal = np.diagonal(m, axis1=1, axis2=2)
    return np.asarray(diagonal * (m.sum(axis=(1, 2)) / diagonal.sum(axis=1))[:, None])


class StoredMatrix:
    """A matrix of a problem's layout, including rows and columns of constrained dofs. Collective.

    Parameters
    ----------
    matrix : BlockMatrix
        The problem's matrix.

    Attributes
    ----------
    mat : PETSc.Mat
        The matrix.
    """

    def __init__(self, matrix: BlockMatrix) -> None:
        self._blocks, self._layout = matrix.without_constraints(), matrix.layout
        self.mat = self._blocks.mat
        #: The matrix without the rows and columns of constrained dofs.
        self._free: PETSc.Mat | None = None

    def assemble(self, add: Callable[[BlockMatrix], Any]) -> None:
        """Overwrite the matrix with what ``add(matrix)`` adds to it. Collective."""
        with self._blocks.adding():
            add(self._blocks)
        self._free = None

    def add_to(self, target: BlockMatrix, factor: float) -> None:
        """Add ``factor`` times the matrix, inside of `BlockMatrix.adding`. Collective.

        Rows and columns of constrained dofs are left out.
        """
        if target.layout is not self._layout:
            self._change_layout(target)
        if self._free is None:
            mask = self.mat.createVecLeft()
            mask.set(1.0)
            mask.array[target.constrained_dofs] = 0.0
            self._free = self.mat.copy()
            self._free.diagonalScale(mask, mask)
        with aij_blocks(self._free, read_only=True) as blocks:
            for block, address in zip(blocks, target.addresses.values, strict=False):
                values = block.array()
                if len(values):
                    daxpy(values, values_at(address, len(values)), a=factor)

    def _change_layout(self, matrix: BlockMatrix) -> None:
        """Copy the values into a new matrix of the changed layout of ``matrix``. Collective.

        Pairs of nodes that only the former pattern has share no cell: their values are zero.
        """
        blocks = matrix.without_constraints()
        blocks.mat.setOption(PETSc.Mat.Option.IGNORE_ZERO_ENTRIES, True)
        blocks.mat.axpy(1.0, self.mat, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self._blocks, self._layout, self.mat = blocks, matrix.layout, blocks.mat
        self._free = None
