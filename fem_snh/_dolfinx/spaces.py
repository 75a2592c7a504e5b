"""Function spaces and elements: their numbering, basis functions and quadrature rules."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import basix
import dolfinx
import numpy as np
import ufl
from dolfinx import fem, plot
from dolfinx.fem import FunctionSpace
from dolfinx.mesh import Mesh

from fem_snh._dolfinx.forms import _quiet
from fem_snh._dolfinx.meshes import (
    _cell_type,
    _rows,
    cell_name,
    geometry_degree,
    num_owned,
    reference_facets,
)
from fem_snh.arrays import Array, ArrayLike
from fem_snh.cache import compiling

#: VTK's numbers of its Lagrange cells.
_VTK_LAGRANGE = {"triangle": 69, "quadrilateral": 70, "tetrahedron": 71, "hexahedron": 72}


def function_space(
    domain: Mesh, degree: int, shape: tuple[int, ...] = (), family: str = "Lagrange"
) -> FunctionSpace:
    """Return a scalar (shape ()) or vector (shape (n,)) space; family "Lagrange" or "DG"."""
    with _quiet(), compiling():
        if hasattr(fem, "functionspace"):  # since 0.7
            return fem.functionspace(domain, (family, degree, shape) if shape else (family, degree))
        if shape:
            return fem.VectorFunctionSpace(domain, (family, degree), dim=shape[0])
        return fem.FunctionSpace(domain, (family, degree))


def renumbered(V: FunctionSpace, numbers: Array) -> FunctionSpace:
    """Return V with other numbers of its nodes; each rank owns the same ones. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The space.
    numbers : (local nodes,) int64
        The new global number of each node.
    """
    domain, dofmap, old = V.mesh, V.dofmap, V._cpp_object
    first, owned = dofmap.index_map.local_range[0], num_nodes(V)[0]
    owners = dofmap.index_map.owners
    index_map = dolfinx.cpp.common.IndexMap(domain.comm, owned, numbers[owned:], owners)
    local = np.concatenate([numbers[:owned] - first, np.arange(owned, len(numbers))])
    cells = local.astype(np.int32)[_rows(dofmap.list, dofmap.dof_layout.num_dofs)]
    cells = dolfinx.cpp.graph.AdjacencyList_int32(cells)
    sizes = dofmap.index_map_bs, dofmap.bs
    new = dolfinx.cpp.fem.DofMap(dofmap.dof_layout, index_map, sizes[0], cells, sizes[1])
    try:
        space = type(old)(old.mesh, old.element, new)
    except TypeError:  # 0.9
        space = type(old)(old.mesh, old.element, new, old.value_shape)
    return FunctionSpace(domain, V.ufl_element(), space)


def function(V: FunctionSpace, name: str) -> fem.Function:
    """Return a zero function on V, with this name in output files."""
    u = fem.Function(V)
    u.name = name
    return u


def surface_measure(domain: Mesh, facets: Array) -> ufl.Measure:
    """Return the UFL measure of the exterior facets among these local facets."""
    return surface_measures(domain, [np.unique(facets)])[0]


def surface_measures(domain: Mesh, groups: Sequence[Array]) -> list[ufl.Measure]:
    """Return measures, of which one form may contain several, of disjoint exterior facets."""
    return _measures(domain, "ds", domain.topology.dim - 1, groups)


def _measures(
    domain: Mesh, kind: str, dim: int, groups: Sequence[Array], **metadata: object
) -> list[ufl.Measure]:
    """Return measures of disjoint groups of entities of dimension ``dim``, numbered from 1."""
    entities = np.concatenate(groups).astype(np.int32)
    numbers = np.repeat(np.arange(len(groups), dtype=np.int32), [len(g) for g in groups])
    order = np.argsort(entities)
    tags = dolfinx.mesh.meshtags(domain, dim, entities[order], numbers[order] + np.int32(1))
    measure = ufl.Measure(kind, domain=domain, subdomain_data=tags, metadata=metadata)
    return [measure(number + 1) for number in range(len(groups))]


def cell_measures(
    domain: Mesh, regions: Sequence[Array], cell: str, degree: int
) -> list[ufl.Measure]:
    """Return the UFL measure of each region, with the quadrature rule of `quadrature`.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    regions : sequence of (n,) int32
        This rank's cells of each region; every cell is in one region.
    cell : str
    degree : int
        As for `quadrature`.
    """
    rule = "default" if _has_positive_weights(cell, degree) else "Xiao-Gimbutas"
    metadata = {"quadrature_degree": degree, "quadrature_rule": rule}
    if len(regions) == 1:
        return [ufl.Measure("dx", domain=domain, metadata=metadata)]
    return _measures(domain, "dx", domain.topology.dim, regions, **metadata)


def constant(domain: Mesh, value: ArrayLike) -> fem.Constant:
    """Return a UFL constant; its value can change without compiling a form again."""
    return fem.Constant(domain, np.asarray(value, dtype=np.float64))


def degree(V: FunctionSpace) -> int:
    """Return the polynomial degree of V's element."""
    element = V.ufl_element()
    # a method in 0.5, an attribute in 0.9 and 0.11
    return int(element.degree if isinstance(element.degree, int) else element.degree())


def node_dofs(V: FunctionSpace) -> Array:
    """Return the local nodes (dof blocks of V) of each owned cell, (cells, nodes) int32."""
    return _rows(V.dofmap.list, V.dofmap.dof_layout.num_dofs)[: num_owned(V.mesh)]


def facet_nodes(V: FunctionSpace) -> Array:
    """Return the nodes on each facet of a cell by their numbers in the cell, (facets, nodes)."""
    dim, layout = V.mesh.topology.dim, V.dofmap.dof_layout
    count = len(reference_facets(cell_name(V.mesh)))
    return np.array([layout.entity_closure_dofs(dim - 1, facet) for facet in range(count)])


def vtk_mesh(V: FunctionSpace) -> tuple[Array, Array, int]:
    """Return the nodes of a Lagrange space as a VTK mesh.

    Returns
    -------
    points : (local nodes, 3)
        Reference coordinates [m].
    cells : (owned cells, nodes) int
        Local nodes in VTK's order.
    kind : int
        VTK's Lagrange cell type, also for degree 1: trilinear faces are then drawn curved.
    """
    # create_vtk_mesh until 0.6
    make = plot.vtk_mesh if hasattr(plot, "vtk_mesh") else plot.create_vtk_mesh
    topology, _, points = make(V)
    cells = topology.reshape(-1, 1 + V.dofmap.dof_layout.num_dofs)[:, 1:]
    return points, np.ascontiguousarray(cells), _VTK_LAGRANGE[cell_name(V.mesh)]


def num_components(V: FunctionSpace) -> int:
    """Return the number of components of V: the size of its dof blocks."""
    return int(V.dofmap.index_map_bs)


def num_nodes(V: FunctionSpace) -> tuple[int, int]:
    """Return the numbers of (owned, ghost) nodes of V on this rank."""
    index_map = V.dofmap.index_map
    return int(index_map.size_local), int(index_map.num_ghosts)


def local_to_global(V: FunctionSpace) -> Array:
    """Return the global number of each local node, (owned + ghost nodes,) int64."""
    index_map = V.dofmap.index_map
    first = index_map.local_range[0]
    owned = np.arange(first, first + index_map.size_local, dtype=np.int64)
    return np.concatenate([owned, np.asarray(index_map.ghosts, dtype=np.int64)])


@cache
def _lagrange(cell: str, degree: int) -> Any:
    """Return basix's Lagrange element, of the same variant as the function spaces."""
    kind, variant = _cell_type(cell), basix.LagrangeVariant.gll_warped
    return basix.create_element(basix.ElementFamily.P, kind, degree, variant)


def reference_nodes(cell: str, degree: int) -> Array:
    """Return the nodes of the Lagrange element on the reference cell, (nodes, dim)."""
    return np.asarray(_lagrange(cell, degree).points)


def tabulate_element(kind: str, degree: int, points: Array, order: int) -> Array:
    """Return the Lagrange basis on a reference cell or facet, and its derivatives.

    Parameters
    ----------
    kind : str
        Name of the reference cell, of any dimension, e.g. "triangle".
    degree : int
        Polynomial degree; the nodes are those of `reference_nodes`.
    points : (n, dimension)
        Points of the reference cell.
    order : int
        Highest order of the derivatives.

    Returns
    -------
    (derivatives, n, nodes)
        Values, then derivatives in basix's order: in two dimensions x, y, xx, xy, yy.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if not len(points):  # basix 0.5 aborts
        points = np.zeros((1, points.shape[1]))
        return tabulate_element(kind, degree, points, order)[:, :0]
    return np.ascontiguousarray(_lagrange(kind, degree).tabulate(order, points)[..., 0])


def _gradients(cell: str, degree: int, points: Array) -> Array:
    return np.ascontiguousarray(np.moveaxis(tabulate_element(cell, degree, points, 1)[1:], 0, -1))


def tabulate_values(V: FunctionSpace, points: Array) -> Array:
    """Return V's scalar basis functions at reference points, (points, nodes)."""
    if degree(V) == 0:
        return np.ones((len(points), 1))
    return tabulate_element(cell_name(V.mesh), degree(V), points, 1)[0]


def tabulate(V: FunctionSpace, points: Array) -> Array:
    """Return reference gradients of V's scalar basis functions, (points, nodes, dim).

    Nodes are in the order of `node_dofs` (for degree 1 and 2 no cell permutes them).
    """
    return _gradients(cell_name(V.mesh), degree(V), points)


def tabulate_geometry_values(domain: Mesh, points: Array) -> Array:
    """Return the geometry's basis functions at reference points, (points, nodes)."""
    return tabulate_element(cell_name(domain), geometry_degree(domain), points, 1)[0]


def tabulate_geometry(domain: Mesh, points: Array) -> Array:
    """Return reference gradients of the geometry's basis, (points, nodes, dim)."""
    return _gradients(cell_name(domain), geometry_degree(domain), points)


def quadrature(cell: str, degree: int) -> tuple[Array, Array]:
    """Return the points (n, dim) and weights (n,) of a quadrature rule on the reference cell.

    The rule is exact for polynomials of this degree. Its weights are positive, so that a weighted
    sum of semidefinite matrices is semidefinite: where basix's default rule has a negative weight
    (degree 3 on tetrahedra), the Xiao-Gimbutas rule replaces it.
    """
    kind = _cell_type(cell)
    points, weights = basix.make_quadrature(kind, degree)
    if not _has_positive_weights(cell, degree):
        rule = basix.QuadratureType.xiao_gimbutas
        try:
            points, weights = basix.make_quadrature(kind, degree, rule=rule)
        except TypeError:  # the rule comes first up to 0.6, last since 0.7
            points, weights = basix.make_quadrature(rule, kind, degree)
    return points, weights


def _has_positive_weights(cell: str, degree: int) -> bool:
    """Return whether basix's default rule of this degree has no negative weight."""
    weights = basix.make_quadrature(_cell_type(cell), degree)[1]
    return bool(weights.min() >= 0)


def locate_dofs(V: FunctionSpace, dim: int, entities: Array) -> Array:
    """Return local nodes of V (int32, ghosts included) on mesh entities. Collective."""
    V.mesh.topology.create_connectivity(dim, V.mesh.topology.dim)
    return np.asarray(fem.locate_dofs_topological(V, dim, np.asarray(entities, np.int32)))


def prescribed(values: Any, nodes: Array) -> Any:
    """Return the Dirichlet condition with the function ``values`` at these local nodes."""
    return fem.dirichletbc(values, np.asarray(nodes, np.int32))
