"""The elastic energy: value, derivative and filtered second derivative.

`Elastic` calls the compiled cell loops of `fem_snh.kernels` on dolfinx spaces, with PETSc vectors
and matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.cell_loops import (
    FIELDS,
    CellLoops,
    compile_cell_loops,
    element_tables,
    restricted,
    selection,
)
from fem_snh.assembly.elements import Element
from fem_snh.assembly.regions import Region
from fem_snh.assembly.unknowns import local_values, writable_values
from fem_snh.cache import compiling
from fem_snh.choices import POINT_FILTERS
from fem_snh.errors import BadInput, choose, on_root
from fem_snh.terms.term import Term


class Part(NamedTuple):
    """A region of the body with the compiled loops over its cells.

    Attributes
    ----------
    region : Region
        The region: a material and its cells.
    loops : CellLoops
        The compiled loops over this rank's cells of the region.
    """

    region: Region
    loops: CellLoops


class Elastic(Term):
    r"""The elastic energy of a body's materials on a finite element space. Collective.

    .. math:: E(u) = \sum_i \int_{\Omega_i} \psi_i(I + \nabla u) \, \mathrm{d}V

    Each material has compiled loops over its own cells; all loops share the element's tables.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    element : Element
        Quadrature and volume treatment.
    regions : sequence of Region
        The materials psi_i with their cells.
    Q : dolfinx function space, optional
        The space of the pressure, if the pressure is an unknown. An equilibrium is then a
        stationary point of the energy, no minimum.
    pressure_scale : float, optional
        The pressure over its unknown [Pa/m].

    Attributes
    ----------
    parts : list of Part
        The regions with their loops.
    shape : tuple of int
        (cells of this rank, nodes per cell).

    Raises
    ------
    BadInput
        On every rank, for a material that the element's volume treatment does not support.
    """

    name = "elastic"

    def __init__(
        self,
        V: Any,
        element: Element,
        regions: Sequence[Region],
        Q: Any = None,
        pressure_scale: float = 1.0,
    ) -> None:
        self._comm = V.mesh.comm
        tables = element_tables(V, element, Q, pressure_scale)
        self.shape = tables.nodes.shape[0], tables.nodes.shape[1]
        with compiling():
            loops = partial(on_root, self._comm, compile_cell_loops)
            compiled = [loops(region.material, tables) for region in regions]
        self.parts = [
            Part(region, CellLoops(kernel, restricted(tables, region.cells, region.fractions)))
            for region, kernel in zip(regions, compiled, strict=True)
        ]
        self.has_energy = all(region.material.has_energy for region in regions)
        self._positions: Array | None = None  # of the matrix for which `_targets` are
        self._free: Array | None = None  # of that matrix
        self._targets: list[Any] = []
        self._kept: list[Array] = []

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy [J]; +inf if F is outside of psi's domain at any point. Collective.

        Raises
        ------
        BadInput
            If a material is defined by a stress and has no energy.
        """
        for material in (part.region.material for part in self.parts):
            if not material.has_energy:
                raise BadInput(f"material '{material.name}' has no energy, only a stress")
        values = local_values(u), _if_any(local_values, p)
        local = sum(part.loops.energy(*values) for part in self.parts)
        return float(self._comm.allreduce(local, op=MPI.SUM))

    def add_residual(
        self,
        u: PETSc.Vec,
        p: PETSc.Vec | None,
        r_u: PETSc.Vec,
        r_p: PETSc.Vec | None,
    ) -> None:
        """Add this rank's part of dE/du [N] and dE/dp to ``r_u`` and ``r_p``, ghosts included."""
        values = (
            local_values(u),
            writable_values(r_u),
            _if_any(local_values, p),
            _if_any(writable_values, r_p),
        )
        for part in self.parts:
            part.loops.residual(*values)

    def add_hessian(
        self,
        u: PETSc.Vec,
        p: PETSc.Vec | None,
        filter: str,
        target: BlockMatrix,
        rotations: Array | None = None,
    ) -> int:
        """Add d2E/du2 [N/m], filtered at each quadrature point: see `Term.add_hessian`.

        With ``rotations`` R (cells of this rank, 3, 3), the 3x3 blocks K_ab of each cell's matrix
        become R K_ab R^T; blocks that couple to an unknown pressure are not rotated.
        """
        which = POINT_FILTERS.index(choose("filter", filter, POINT_FILTERS))
        values, pressure = local_values(u), _if_any(local_values, p)
        filtered = 0
        for part, struct in zip(self.parts, self._structs(target), strict=True):
            target.addresses.set(struct)
            turned = None
            if rotations is not None:
                cells = selection(part.region.cells, len(rotations))
                turned = np.ascontiguousarray(rotations[cells])
            struct.rotation = part.loops.pointer(turned)
            filtered += part.loops.jacobian(values, which, struct, pressure)
        return filtered

    def _structs(self, matrix: BlockMatrix) -> list[Any]:
        """Return a C struct per part, which says where its loops add element matrices."""
        if matrix.block_positions is not self._positions or matrix.free is not self._free:
            self._positions, self._free = matrix.block_positions, matrix.free
            self._targets, self._kept = [], []
            for part in self.parts:
                cells = selection(part.region.cells, len(matrix.block_positions))
                positions, constrained = matrix.block_positions[cells], matrix.is_constrained[cells]
                # The struct has pointers to these arrays, which must live as long.
                self._kept += [positions, constrained]
                self._targets.append(
                    part.loops.target(matrix.row_strides, positions, matrix.free, constrained)
                )
        return self._targets

    def set_pressure_damping(self, ratio: float = 0.0, origin: Array | None = None) -> None:
        r"""Set the viscous part of an unknown pressure; without arguments, remove it.

        The unknown is then :math:`p = p_e + s (p_e - w)` with the elastic pressure
        :math:`p_e = U'(J)`. The integral of :math:`\psi' + p J - (1 + s) U^*(p_e)` is stationary
        in p.

        Parameters
        ----------
        ratio : float
            The factor s.
        origin : (local pressures,)
            The pressure w, in the unit of the unknown, ghosts included.
        """
        for part in self.parts:
            part.loops.set_pressure_damping(ratio, origin)

    def cell_fields(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> dict[str, Array]:
        """Return the fields of `Problem.cell_fields` by name, one value per cell of this rank.

        The values are NaN in cells without a material.
        """
        values = local_values(u), _if_any(local_values, p)
        fields: dict[str, Array] = {name: np.full(self.shape[0], np.nan) for name in FIELDS}
        for part in self.parts:
            for name, value in part.loops.fields(*values).items():
                fields[name][part.region.cells] = value
        return fields


def loops_over(V: Any, element: Element, region: Region) -> CellLoops:
    """Return compiled loops over a region that need not belong to an `Elastic` term. Collective."""
    tables = element_tables(V, element)
    compiled = on_root(V.mesh.comm, compile_cell_loops, region.material, tables)
    return CellLoops(compiled, restricted(tables, region.cells, region.fractions))


def _if_any(values: Callable[[PETSc.Vec], Array], vector: PETSc.Vec | None) -> Array | None:
    """Return ``values(vector)``, or None for the vector of a pressure that is no unknown."""
    return None if vector is None else values(vector)
