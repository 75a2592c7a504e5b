"""The compiled loops over the cells of one material and one element.

`fem_snh.terms.elastic` calls them for the energy, the residual, the Jacobian and cell fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.elements import Element
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.choices import EIGENSOLVERS
from fem_snh.kernels import build
from fem_snh.kernels.build import header
from fem_snh.kernels.material import Compiled, Material, compile_kernel

#: Results of `CellLoops.fields`, in the order of fields_cells (cell_api.h).
FIELDS = ("volume", "deformed_volume", "min_J", "energy", "min_eigenvalue")

#: The header of each volume treatment (`fem_snh.assembly.elements`). Cell pressures are evaluated
#: like continuous pressures, with one basis function in each cell.
_VOLUME_HEADERS = {
    "pointwise": "volume_pointwise.h",
    "mean": "volume_mean.h",
    "cell_pressure": "volume_pressure.h",
    "pressure": "volume_pressure.h",
}


@dataclass(frozen=True)
class TensorBasis:
    """A basis of products of functions of one variable, with quadrature points on a grid.

    The place of a node or point in its grid is that of its indices (1, 2, 3) in a C array.

    Attributes
    ----------
    basis : (2, points, nodes)
        Values and derivatives of the functions on the interval, at its quadrature points.
    nodes : (NODES,) int
        The node at each place of the grid.
    points : (POINTS,) int
        The place of each quadrature point.
    """

    basis: Array
    nodes: Array
    points: Array

    @classmethod
    def of(cls, element: Element) -> TensorBasis | None:
        """Return the basis of hexahedra of degree 2 or more; None where whole sums are faster."""
        if element.cell != "hexahedron" or element.degree == 1:
            return None
        x, _ = _dolfinx.quadrature("interval", element.quadrature)
        points, _ = _dolfinx.quadrature(element.cell, element.quadrature)
        on_interval = _dolfinx.reference_nodes("interval", element.degree)
        nodes = _dolfinx.reference_nodes(element.cell, element.degree)
        basis = _dolfinx.tabulate_element("interval", element.degree, x, 1)
        places = _places(nodes, on_interval)
        return cls(basis, np.argsort(places), _places(points, x))

    @property
    def definitions(self) -> list[str]:
        """The sizes and tables as lines of C."""
        numbers = {"BASIS": self.basis, "NODE": self.nodes, "POINT": self.points}
        return [
            f"#define TENSOR_POINTS {self.basis.shape[1]}",
            f"#define TENSOR_NODES {self.basis.shape[2]}",
            *(f"#define TENSOR_{n} {', '.join(map(str, a.ravel()))}" for n, a in numbers.items()),
        ]


def _places(points: Array, coordinates: Array) -> Array:
    """Return the places of points (n, 3) in the grid of some coordinates (m, 1)."""
    indices = np.abs(points[:, :, None] - coordinates[:, 0]).argmin(axis=2)
    return np.ravel_multi_index(indices.T, (len(coordinates),) * 3)


@dataclass(frozen=True)
class ElementTables:
    """Basis, quadrature and node numbers of an element on one rank's cells.

    Attributes
    ----------
    nodes : (cells, NODES) int32
        Displacement nodes.
    geometry : (cells, GEOMETRY_NODES) int32
        Geometry nodes.
    x : (geometry nodes, 3)
        Reference coordinates [m].
    gradients : (POINTS, NODES, 3)
        Gradients of the basis on the reference cell. In two dimensions the third entry is 0; on a
        body of revolution it is the basis function itself (kinematics.h).
    geometry_gradients : (POINTS, GEOMETRY_NODES, 3)
        Gradients of the geometry's basis, with the same third entry.
    weights : (POINTS,)
        Quadrature weights on the reference cell, on a body of revolution times 2 pi.
    volume : str
        Volume treatment, one of `fem_snh.assembly.elements`.
    pressure_nodes : (cells, PRESSURE_NODES) int32
        Pressure nodes; empty if the pressure is no unknown of the problem.
    pressure_basis : (POINTS, PRESSURE_NODES)
        Values of the pressure's basis.
    fractions : (cells,), optional
        The fraction of each cell that the body fills, a factor of the cell's weights. None: 1.
    kinematics : Kinematics
        How the displacement becomes a deformation gradient.
    tensor : TensorBasis, optional
        The basis as products, by which the stiffness is summed. None: over all points at once.
    """

    nodes: Array
    geometry: Array
    x: Array
    gradients: Array
    geometry_gradients: Array
    weights: Array
    volume: str = "pointwise"
    pressure_nodes: Array = field(default_factory=lambda: np.empty((0, 0), np.int32))
    pressure_basis: Array = field(default_factory=lambda: np.empty((0, 0)))
    fractions: Array | None = None
    kinematics: Kinematics = SOLID
    tensor: TensorBasis | None = None

    @property
    def sizes(self) -> list[str]:
        """The element's sizes and kinematics as lines of C, e.g. "#define POINTS 4"."""
        points, nodes, _ = self.gradients.shape
        return [
            f"#define POINTS {points}",
            f"#define NODES {nodes}",
            f"#define GEOMETRY_NODES {self.geometry_gradients.shape[1]}",
            f"#define PRESSURE_NODES {self.pressure_basis.shape[1]}",
            *self.kinematics.definitions,
            *(self.tensor.definitions if self.tensor else ()),
        ]


def compile_cell_loops(
    material: Material, tables: ElementTables, loops: Sequence[str] = ("cell_loops.h",)
) -> Compiled:
    """Compile the cell loops of a material on an element. Not collective.

    ``loops`` are the files of ``fem_snh/kernels/include`` with the loops.
    """
    volume = _VOLUME_HEADERS[tables.volume]
    target = "cell_api.h", "split_double.h", "matrix_target.h"
    tensor = ("tensor_stiffness.h",) if tables.tensor else ()
    elements = "kinematics.h", "element_matrices.h", *tensor
    after = (*target, *elements, volume, "cell_batches.h", *loops)
    entries = tables.kinematics.entries
    return compile_kernel(material, tables.volume, tables.sizes, after, entries)


class CellLoops:
    """Energy, residual, Jacobian and fields over one rank's cells.

    Methods take values at this rank's nodes, ghosts included: displacements ``u``
    (components * nodes,) [m] and, if the pressure is an unknown of the problem, ``pressure``
    (pressure nodes,). They are not collective.

    Parameters
    ----------
    compiled : Compiled
        The library from `compile_cell_loops`.
    tables : ElementTables
        The element's tables.

    Attributes
    ----------
    constants : ElementConstants
        The constants of the material's energy.
    tables : ElementTables
        The element's tables.
    num_cells : int
        Number of cells.
    """

    def __init__(self, compiled: Compiled, tables: ElementTables) -> None:
        self.constants, self.tables = compiled.constants, tables
        self._ffi, self._lib = build.load(compiled.path, header("cell_api.h"))
        self.num_cells = len(tables.nodes)
        # Cells one after the other add to the same rows of the matrix, which then stay in cache.
        order = np.argsort(tables.nodes.min(axis=1), kind="stable")
        integers = {"number": order, "nodes": tables.nodes[order]}
        integers["geometry"] = tables.geometry[order]
        if len(tables.pressure_nodes):
            integers["pressure_nodes"] = tables.pressure_nodes[order]
        names = "x", "gradients", "geometry_gradients", "weights", "pressure_basis"
        numbers: dict[str, Any] = {name: getattr(tables, name) for name in names}
        numbers["constants"] = compiled.constants.values
        if tables.fractions is not None:
            numbers["fractions"] = tables.fractions[order]
        arrays = {name: np.ascontiguousarray(a, dtype=np.int32) for name, a in integers.items()}
        arrays |= {name: np.ascontiguousarray(a, dtype=np.float64) for name, a in numbers.items()}
        self._arrays = arrays  # the struct holds pointers: the arrays must live as long
        pointers = {name: self.pointer(array) for name, array in arrays.items()}
        self._cells = self._ffi.new("Cells *", {"cells": self.num_cells, **pointers})

    def set_pressure_damping(self, ratio: float, origin: Array | None) -> None:
        """Set the viscous part of the pressure unknown: see `Elastic.set_pressure_damping`."""
        self._origin = origin  # the struct holds a pointer to this array
        self._cells.pressure_damping, self._cells.pressure_origin = ratio, self.pointer(origin)

    def pointer(self, array: Array | None) -> Any:
        """Return a C pointer to ``array``, which the caller keeps alive; NULL for None."""
        return self._ffi.NULL if array is None else build.pointer(self._ffi, array)

    def target(
        self, strides: Sequence[Array], position: Array, free: Array, constrained: Array
    ) -> Any:
        """Return a MatrixTarget (cell_api.h) for `jacobian`.

        The arguments are ``row_strides``, ``block_positions``, ``free`` and ``is_constrained`` of a
        `BlockMatrix`. The caller keeps them alive, and before each use sets the addresses of the
        values (`fem_snh.kernels.cell_matrices.Addresses`) and ``rotation``, if used.
        """
        target = self._ffi.new("MatrixTarget *")
        target.stride = [self.pointer(stride) for stride in strides]
        target.position = self.pointer(position)
        target.free = self.pointer(free)
        target.constrained = self.pointer(constrained)
        return target

    @property
    def cells_address(self) -> int:
        """Return the address of the struct Cells (cell_api.h), valid as long as this object."""
        return int(self._ffi.cast("uintptr_t", self._cells))

    def energy(self, u: Array, pressure: Array | None = None) -> float:
        """Return the energy [J] of this rank's cells; +inf outside the energy's domain."""
        return float(self._lib.energy_cells(self._cells, *map(self.pointer, (u, pressure))))

    def residual(
        self, u: Array, r: Array, pressure: Array | None = None, r_pressure: Array | None = None
    ) -> None:
        """Add dE/du [N] to ``r`` and dE/dp to ``r_pressure``, at ghost nodes too."""
        arrays = map(self.pointer, (u, pressure, r, r_pressure))
        self._lib.residual_cells(self._cells, *arrays)

    def jacobian(self, u: Array, filter: int, target: Any, pressure: Array | None = None) -> int:
        """Add the filtered second derivative of the energy to ``target``.

        Parameters
        ----------
        filter : int
            Position in `fem_snh.choices.POINT_FILTERS`.
        target : MatrixTarget
            From `target`.

        Returns
        -------
        int
            Number of quadrature points where the exact material Hessian has a negative eigenvalue.
        """
        arrays = map(self.pointer, (u, pressure))
        solver = EIGENSOLVERS.index("cubic")
        return int(self._lib.jacobian_cells(self._cells, *arrays, filter, solver, target))

    def fields(self, u: Array, pressure: Array | None = None) -> dict[str, Array]:
        """Return each of FIELDS, (cells,): volumes [m^3], J, energy [J], eigenvalue [Pa]."""
        out = np.empty((self.num_cells, len(FIELDS)))
        self._lib.fields_cells(self._cells, *map(self.pointer, (u, pressure, out)))
        return dict(zip(FIELDS, out.T, strict=True))


def element_tables(
    V: FunctionSpace,
    element: Element,
    Q: FunctionSpace | None = None,
    pressure_scale: float = 1.0,
) -> ElementTables:
    """Return basis, geometry and quadrature of ``element`` on this rank's cells of V.

    The basis functions of the pressure space Q, if given, are multiplied by ``pressure_scale``.
    """
    domain, kinematics = V.mesh, element.kinematics
    points, weights = _dolfinx.quadrature(element.cell, element.quadrature)
    gradients, geometry = _dolfinx.tabulate(V, points), _dolfinx.tabulate_geometry(domain, points)
    if kinematics.dim == 2:
        N = _dolfinx.tabulate_values(V, points)
        gradients = _with_third(gradients, N, kinematics)
        N = _dolfinx.tabulate_geometry_values(domain, points)
        geometry = _with_third(geometry, N, kinematics)
    if kinematics.revolved:
        weights = 2 * np.pi * weights  # the whole turn
    tables = ElementTables(
        _dolfinx.node_dofs(V),
        _dolfinx.geometry_dofs(domain),
        _dolfinx.geometry_x(domain),
        gradients,
        geometry,
        weights,
        element.volume,
        kinematics=kinematics,
        tensor=TensorBasis.of(element),
    )
    if Q is None:
        return tables
    basis = pressure_scale * _dolfinx.tabulate_values(Q, points)
    return replace(tables, pressure_nodes=_dolfinx.node_dofs(Q), pressure_basis=basis)


def _with_third(gradients: Array, basis: Array, kinematics: Kinematics) -> Array:
    """Return ``gradients`` (points, nodes, 2) with the third entry that kinematics.h expects.

    ``basis`` (points, nodes) are the values of the basis functions.
    """
    third = basis if kinematics.revolved else np.zeros_like(basis)
    return np.concatenate([gradients, third[:, :, None]], axis=2)


def restricted(
    tables: ElementTables, cells: Array, fractions: Array | None = None
) -> ElementTables:
    """Return an element's tables on some cells, (n,), with the cells' fractions (n,) or None."""
    chosen = selection(cells, len(tables.nodes))
    pressure = tables.pressure_nodes
    return replace(
        tables,
        nodes=tables.nodes[chosen],
        geometry=tables.geometry[chosen],
        fractions=fractions,
        pressure_nodes=pressure[chosen] if len(pressure) else pressure,
    )


def selection(cells: Array, num_cells: int) -> Any:
    """Return an index of ``cells``: a slice, which copies nothing, if they are all cells."""
    return slice(None) if len(cells) == num_cells else cells


#: Quadrature points per batch: its arrays, 720 kB each, stay in the processor's cache.
_BATCH = 10_000


class PointStrains(NamedTuple):
    """Volumes and strains at the quadrature points of cells.

    Attributes
    ----------
    weights : (cells, points)
        Quadrature weights [m^3], times the fraction of the cell that the body fills.
    growth : (cells, points)
        J - 1, computed without cancellation at small strain.
    strain, shear : float
        Integrals over the cells of the squared Frobenius norms of the Green-Lagrange strain and of
        its deviator [m^3].
    """

    weights: Array
    growth: Array
    strain: float
    shear: float


def point_strains(tables: ElementTables, u: Array) -> PointStrains:
    """Return volumes and strains at the quadrature points of an element's cells.

    In plane stress the strains are those of plane strain (F_33 = 1). Not collective.

    Parameters
    ----------
    tables : ElementTables
        The tables of the element on the cells.
    u : (components * nodes,)
        Displacements [m] of this rank's nodes, ghosts included.
    """
    shape = len(tables.nodes), len(tables.weights)
    weights, growth = np.empty(shape), np.empty(shape)
    strain = shear = 0.0
    kinematics = tables.kinematics
    nodal = kinematics.padded(u)
    batch = max(1, _BATCH // shape[1])
    for start in range(0, shape[0], batch):
        chunk = slice(start, start + batch)
        x = tables.x[tables.geometry[chunk]]
        T = np.einsum("cai,qak->cqik", x, tables.geometry_gradients, optimize=True)
        kinematics.set_third_tangent(T)
        weights[chunk] = np.abs(np.linalg.det(T)) * tables.weights
        values = nodal[tables.nodes[chunk]]
        gradient = np.einsum("cai,qak->cqik", values, tables.gradients, optimize=True)
        H = gradient @ np.linalg.inv(T)
        kinematics.set_third_column(H)
        trace, HH = np.trace(H, axis1=2, axis2=3), np.einsum("cqij,cqji->cq", H, H)
        growth[chunk] = trace + (trace**2 - HH) / 2 + np.linalg.det(H)
        H_T = np.swapaxes(H, 2, 3)
        E = (H + H_T + H_T @ H) / 2
        squares, mean = (E**2).sum(axis=(2, 3)), np.trace(E, axis1=2, axis2=3) / 3
        if tables.fractions is not None:
            weights[chunk] *= tables.fractions[chunk, None]
        strain += float((weights[chunk] * squares).sum())
        shear += float((weights[chunk] * (squares - 3 * mean**2)).sum())
    return PointStrains(weights, growth, strain, shear)


def cell_centres(tables: ElementTables, cells: Array) -> Array:
    """Return the mean of the geometry nodes [m] of some of the cells, (n, 3)."""
    return tables.x[tables.geometry[cells]].mean(axis=1)
