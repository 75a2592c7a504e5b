"""gmsh in this process: mesh a source or a shape, read a file or fill a surface.

gmsh runs without output or questions, is always finalised, and Python keeps handling Ctrl-C. A
child process imports this module to read a file, so it imports neither dolfinx nor MPI.
"""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from itertools import product
from math import factorial, isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value, in_words, unknown_name

#: gmsh's element type: cell, degree of the geometry, nodes per cell (gmsh manual, MSH format).
_CELLS = {
    2: ("triangle", 1, 3),
    3: ("quadrilateral", 1, 4),
    9: ("triangle", 2, 6),
    10: ("quadrilateral", 2, 9),
    4: ("tetrahedron", 1, 4),
    5: ("hexahedron", 1, 8),
    11: ("tetrahedron", 2, 10),
    12: ("hexahedron", 2, 27),
}
CELL_KINDS = sorted({cell for cell, *_ in _CELLS.values()})
#: Parameter of every source in meshes/: 1 for tetrahedra (triangles), 0 for hexahedra
#: (quadrilaterals).
_TETRAHEDRA = "tets"
#: Parameter of the sources with a two-dimensional mesh: 1 for this mesh.
_PLANE = "plane"
#: Least number of curved cells around a circle, in built-in bodies and in shapes of files, whose
#: holes may be small beside the body. The radius has a relative error of at most 7e-4 and 1.5e-4.
_ROUND, _AROUND_SHAPE = 8, 12
#: Least cell size of a shape over its longest extent: a cone's tip has an infinite curvature.
_LEAST = 1e-3
#: gmsh's type of straight edges and plane faces, by the body's dimension.
_STRAIGHT = {2: "Line", 3: "Plane"}
#: The ends of the edges on which nodes 4 to 9 are (gmsh reference manual, node ordering).
_EDGES = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)])
#: The least Jacobian determinant of a cell over that of the cell with straight edges.
_LEAST_DETERMINANT = 0.1
#: The distance of an edge from the straight edge is halved this often, and then set to zero.
_HALVES = 4
#: The cells of meshes of two dimensions.
_PLANE_CELLS = ("triangle", "quadrilateral")


#: Largest extent along z of a mesh in the plane, relative to its coordinates: rounding.
FLAT = 1e-12


@dataclass(frozen=True)
class Skin:
    """A triangulated surface whose points move with the cells of a mesh; the same on all ranks.

    Attributes
    ----------
    points : (n, 3) array
        Reference positions [length].
    triangles : (m, 3) int32 array
        The points of each triangle, anticlockwise as seen from outside.
    cells : (n,) int64 array
        The cell that carries each point, by its row in the mesh's input: cells of a lattice with
        separate parts overlap, so a position alone does not tell.
    """

    points: Array
    triangles: Array
    cells: Array


@dataclass(frozen=True)
class NodeCopies:
    """Lattice nodes at positions where another part of the body is closer than their own part.

    Where several parts of a body pass through one cube of a lattice, each part has its own cell
    there, with nodes at the same coordinates. The node of the closest part counts; the other nodes
    are copies.

    Attributes
    ----------
    cells : (n,) int array
        Cells with coincident nodes, by their rows in the mesh's input.
    copied : (n, 27) bool array
        Which of a cell's nodes of degree 2 are copies; nodes sorted by reference coordinates.
    """

    cells: Array
    copied: Array


class PhysicalGroup(NamedTuple):
    """A physical group, by the numbers of cells and nodes in `MeshData`.

    Attributes
    ----------
    name, dim, tag : str, int, int
        As in `fem_snh.mesh.mesh.Group`.
    entities : (n,) or (n, corners) int64
        Rows of cells, for the mesh's dimension; otherwise the corner nodes of each element.
    """

    name: str
    dim: int
    tag: int
    entities: np.ndarray


class MeshData(NamedTuple):
    """A mesh as rank 0 gets it from gmsh.

    Attributes
    ----------
    cells : (cells, nodes per cell) int64
        Rows of ``x``, in gmsh's order of nodes in this module, in dolfinx's order elsewhere.
    x : (nodes, dimension)
        Coordinates [m].
    cell : {"hexahedron", "tetrahedron", "quadrilateral", "triangle"}
        Kind of cell.
    degree : int
        Degree of the geometry, 1 or 2.
    groups : list of PhysicalGroup
        The physical groups.
    fractions : (cells,) array or None
        For a lattice, the part of each cell's volume that the body fills.
    skin : Skin or None
        For a lattice, the surface of the body.
    copies : NodeCopies or None
        For a lattice, the nodes that are copies.
    """

    cells: np.ndarray
    x: np.ndarray
    cell: str
    degree: int
    groups: list[PhysicalGroup]
    fractions: np.ndarray | None = None
    skin: Skin | None = None
    copies: NodeCopies | None = None


class SizeField(NamedTuple):
    """A field of cell sizes, linear in each cell of a mesh.

    Attributes
    ----------
    x : (cells, corners, 3) array
        The corners of triangles or tetrahedra [m].
    sizes : (cells, corners) array
        Wanted edge lengths at the corners [m].
    """

    x: Array
    sizes: Array


@contextmanager
def session() -> Iterator[Any]:
    """Yield gmsh, initialised and silent; finalise it in any case. Raises BadInput without gmsh."""
    # gmsh installs its own handler: 4.8 on import, later versions on initialize.
    handler = signal.getsignal(signal.SIGINT)
    try:
        gmsh = _imported()
    except (ImportError, OSError) as error:
        raise BadInput(f"gmsh's Python module cannot be used: {error}") from None
    gmsh.initialize(readConfigFiles=False)
    try:
        signal.signal(signal.SIGINT, handler)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.ExpertMode", 1)  # no questions on standard input
        gmsh.onelab.clear()  # parameters survive finalize
        yield gmsh
    finally:
        gmsh.finalize()
        signal.signal(signal.SIGINT, handler)


def _imported() -> Any:
    """Import gmsh in half the time.

    dolfinx makes all symbols of its 180 libraries global, where the loader would look for each of
    gmsh's before it looks in gmsh's own 90: with RTLD_DEEPBIND it begins there. It would not find
    the allocator of a preloaded library, with which the program's other parts free memory.
    """
    own_first = 0 if os.environ.get("LD_PRELOAD") else getattr(os, "RTLD_DEEPBIND", 0)
    with_own_symbols = partial(ctypes.CDLL, mode=os.RTLD_LOCAL | own_first)
    default = ctypes.CDLL
    ctypes.CDLL = with_own_symbols  # type: ignore[misc,assignment]  # gmsh only calls it
    try:
        return import_module("gmsh")
    finally:
        ctypes.CDLL = default  # type: ignore[misc]  # a class, put back


def generate(
    path: Path, cell: str, parameters: dict[str, float], sizes: SizeField | None = None
) -> MeshData:
    """Mesh a gmsh source with this kind of cell and these values of its parameters.

    Cell sizes are those of the source, or of the field ``sizes`` if given.
    """
    with session() as gmsh:
        gmsh.open(str(path))  # defines the parameters; opened again with their values below
        names = [name for name in gmsh.onelab.getNames() if "/" not in name]
        known = [name for name in names if name not in (_TETRAHEDRA, _PLANE)]
        gmsh.onelab.setNumber(_TETRAHEDRA, [float(cell in ("tetrahedron", "triangle"))])
        if cell in _PLANE_CELLS:
            if _PLANE not in names:
                raise BadInput("it has 3 dimensions: expected no 'kinematics'")
            gmsh.onelab.setNumber(_PLANE, [1.0])
        for name, value in parameters.items():
            if name not in known:
                raise unknown_name("parameter", name, known)
            if not isfinite(value):
                raise bad_value(name, value, "a finite number")
            gmsh.onelab.setNumber(name, [float(value)])
        gmsh.clear()
        gmsh.open(str(path))
        if sizes is not None:
            _set_sizes(gmsh, sizes, _ROUND)
        gmsh.model.mesh.generate(2 if cell in _PLANE_CELLS else 3)
        data = _extract(gmsh)
    return _straightened(data)


def mesh_shape(path: str, folder: str, cells: int, sizes: SizeField | None = None) -> MeshData:
    """Mesh the shape of an .xao file with simplices, of degree 2 if a face is curved.

    Parameters
    ----------
    path : str
        The file.
    folder : str
        An empty folder to work in.
    cells : int
        Cells along the longest extent of the body; ignored with ``sizes``.
    sizes : SizeField, optional
        The cell sizes. Default: equal sizes.
    """
    with session() as gmsh:
        _load_shape(gmsh, Path(path), Path(folder))
        dim = gmsh.model.getDimension()
        kinds = {gmsh.model.getType(*entity) for entity in gmsh.model.getEntities(dim - 1)}
        gmsh.option.setNumber("Mesh.ElementOrder", 1 if kinds <= {_STRAIGHT[dim]} else 2)
        bounds = np.array(gmsh.model.getBoundingBox(-1, -1)).reshape(2, 3)
        extent = np.ptp(bounds, axis=0).max()
        if sizes is None:
            _set_largest_size(gmsh, extent / cells, _AROUND_SHAPE)
        else:
            _set_sizes(gmsh, sizes, _AROUND_SHAPE)
        gmsh.option.setNumber("Mesh.MeshSizeMin", _LEAST * extent)
        gmsh.model.mesh.generate(dim)
        data = _extract(gmsh)
    return _straightened(data)


def _load_shape(gmsh: Any, path: Path, folder: Path) -> None:
    """Load the shape and the groups of an .xao file as gmsh's model."""
    from fem_snh.mesh import xao

    brep, counts, groups = xao.read(path)
    file = folder / "shape.brep"
    file.write_text(brep, encoding="utf-8")
    gmsh.model.occ.importShapes(str(file), False)
    gmsh.model.occ.synchronize()
    tags = [[tag for _, tag in gmsh.model.getEntities(dim)] for dim in range(4)]
    found = [len(of_dim) for of_dim in tags]
    if found != counts or max(found[2:]) == 0:
        listed = ", ".join(f"{count} {kind}" for count, kind in zip(counts, xao.LISTS, strict=True))
        raise BadInput(f"it lists {listed}: its shape has {', '.join(map(str, found))}")
    loose = _loose(gmsh)
    for group in groups:
        if loose[group.dim]:  # gmsh numbers these in another order than the file
            raise BadInput(
                f"it has {xao.LISTS[group.dim]} that bound no part of the body, so that its groups "
                "of them are not known: expected a shape without (gmsh's BooleanFragments)"
            )
        chosen = [tags[group.dim][rank] for rank in group.entities]
        number = gmsh.model.addPhysicalGroup(group.dim, chosen, group.tag)
        if group.name:
            gmsh.model.setPhysicalName(group.dim, number, group.name)


def _loose(gmsh: Any) -> list[list[tuple[int, int]]]:
    """Return, by dimension, the (dim, tag) of the entities that bound no part of the body."""
    found, dim = list[list[tuple[int, int]]]([[], [], [], []]), gmsh.model.getDimension()
    level = gmsh.model.getEntities(dim)
    for lower in range(dim)[::-1]:
        level = gmsh.model.getBoundary(level, False, False)
        found[lower] = sorted(set(gmsh.model.getEntities(lower)) - set(level))
    return found


def _straightened(data: MeshData) -> MeshData:
    """Return the mesh with `straightened` coordinates, if it has tetrahedra of degree 2."""
    if data.degree == 1 or data.cell != "tetrahedron":
        return data
    return data._replace(x=straightened(data.cells, data.x))


def straightened(cells: Array, x: Array) -> Array:
    """Return coordinates with which no tetrahedron of degree 2 is inverted.

    gmsh curves the surface edges of a straight mesh, which inverts cells that are large beside the
    surface's radius. Their edges are moved back towards straight edges; neighbours keep their
    common nodes, and all other edges stay on the surface.

    Parameters
    ----------
    cells : (n, 10) int
        The nodes of cells, in gmsh's order; with straight edges the cells must be valid.
    x : (nodes, 3)
        Coordinates.
    """
    x, ends = x.copy(), cells[:, _EDGES]
    middle = x.copy()
    middle[cells[:, 4:]] = (x[ends[..., 0]] + x[ends[..., 1]]) / 2
    times = np.zeros(len(x), dtype=int)
    while True:
        bad = least_determinants(x[cells]) < _LEAST_DETERMINANT
        nodes = np.unique(cells[bad, 4:])
        nodes = nodes[times[nodes] <= _HALVES]
        if not len(nodes):
            return x
        part = np.where(times[nodes] < _HALVES, 0.5, 0.0)[:, None]
        x[nodes] = middle[nodes] + part * (x[nodes] - middle[nodes])
        times[nodes] += 1


def least_determinants(x: Array) -> Array:
    """Return a lower bound (n,) of each cell's Jacobian determinant over that of straight edges.

    The determinant is a polynomial of degree 3, and nowhere below its least Bernstein coefficient
    (Johnen, Remacle & Geuzaine 2013).

    Parameters
    ----------
    x : (n, 10, 3)
        The nodes of tetrahedra of degree 2, in gmsh's order.
    """
    gradients, coefficients = _tables()
    jacobian = np.einsum("cni,pnj->cpij", x, gradients, optimize=True)
    straight = np.linalg.det(x[:, 1:4] - x[:, :1])
    return (np.linalg.det(jacobian) @ coefficients.T).min(axis=1) / straight


@cache
def _tables() -> tuple[Array, Array]:
    """Return P2 gradients (20, 10, 3) at the nodes of P3, and a matrix (20, 20).

    The matrix maps values at these nodes to Bernstein coefficients.
    """
    powers = np.array([p for p in product(range(4), repeat=4) if sum(p) == 3])
    points = powers / 3  # barycentric
    slopes = np.vstack([-np.ones(3), np.eye(3)])  # of the barycentric coordinates
    at_corners = np.einsum("pn,nj->pnj", 4 * points - 1, slopes)
    i, j = _EDGES.T
    at_edges = 4 * (points[:, i, None] * slopes[j] + points[:, j, None] * slopes[i])
    multinomial = [6 / np.prod([factorial(k) for k in power]) for power in powers]
    bernstein = np.prod(points[:, None] ** powers, axis=2) * multinomial
    return np.concatenate([at_corners, at_edges], axis=1), np.linalg.inv(bernstein)


def _set_sizes(gmsh: Any, field: SizeField, around: int) -> None:
    """Let a field determine cell sizes, and the curvature also those of curved cells.

    Larger curved cells would be inverted and `straightened`: with 12 cells along the arm, a tenth
    of a bone would be lost.
    """
    view = gmsh.view.add("sizes")
    kind = "ST" if field.x.shape[1] == 3 else "SS"
    points = field.x.transpose(0, 2, 1).reshape(len(field.x), -1)
    rows = np.hstack([points, field.sizes])
    gmsh.view.addListData(view, kind, len(rows), rows.ravel())
    number = gmsh.model.mesh.field.add("PostView")
    gmsh.model.mesh.field.setNumber(number, "ViewTag", view)
    gmsh.model.mesh.field.setAsBackgroundMesh(number)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    _set_largest_size(gmsh, float(field.sizes.max()), around)


def _set_largest_size(gmsh: Any, size: float, around: int) -> None:
    """Set the largest cell size, and at least ``around`` curved cells around a circle."""
    gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)  # by default a tenth of the body's extent
    is_curved = gmsh.option.getNumber("Mesh.ElementOrder") > 1
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", around if is_curved else 0)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)


def read(path: str) -> MeshData:
    """Read a .msh file, which must be alone in its folder: gmsh executes ``<path>.opt``."""
    with session() as gmsh:
        gmsh.merge(path)
        return _extract(gmsh)


def fill(points: np.ndarray, triangles: np.ndarray, size: float) -> MeshData:
    """Fill a closed surface, whose triangles are the boundary facets, with tetrahedra.

    Parameters
    ----------
    points, triangles : (n, 3) array, (m, 3) int array
        The surface.
    size : float
        Largest length of the edges inside [length].
    """
    with session() as gmsh:
        model = gmsh.model
        surface = model.addDiscreteEntity(2)
        model.mesh.addNodes(2, surface, np.arange(1, len(points) + 1), points.ravel())
        model.mesh.addElementsByType(surface, 2, [], triangles.ravel() + 1)
        volume = model.geo.addVolume([model.geo.addSurfaceLoop([surface])])
        model.geo.synchronize()
        for dim, tag, name in ((3, volume, "body"), (2, surface, "boundary")):
            model.setPhysicalName(dim, model.addPhysicalGroup(dim, [tag]), name)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        model.mesh.generate(3)
        model.mesh.optimize("")
        return _extract(gmsh)


def _extract(gmsh: Any) -> MeshData:
    """Return the cells and the physical groups of gmsh's current model.

    The cells are volumes; if there are none, surfaces in the plane z = 0.
    """
    mesh, dimension = gmsh.model.mesh, 3
    types, cell_tags, cell_nodes = mesh.getElements(3)
    if not len(types):
        dimension = 2
        types, cell_tags, cell_nodes = mesh.getElements(2)
    if not len(types):
        raise BadInput("it has no volume cells: mesh in 3 dimensions, and save all elements")
    if len(types) > 1 or types[0] not in _CELLS:
        names = in_words(mesh.getElementProperties(kind)[0] for kind in types)
        wanted = "tetrahedra or hexahedra" if dimension == 3 else "triangles or quadrilaterals"
        raise BadInput(
            f"it has cells {names}: expected only {wanted}, of order 1 or 2 "
            "(Mesh.SecondOrderIncomplete = 0 gives hexahedra 27 nodes, quadrilaterals 9)"
        )
    kind, degree, size = _CELLS[types[0]]
    # Drop nodes without a cell (centres of arcs); gmsh's node numbers may have gaps.
    used, cells = np.unique(np.asarray(cell_nodes[0], dtype=np.int64), return_inverse=True)
    cells = cells.reshape(-1, size)
    # Format 2.2 repeats a cell for each of its physical groups.
    _, first, row = np.unique(np.sort(cells), axis=0, return_index=True, return_inverse=True)
    row_of_tag = dict(zip(cell_tags[0].tolist(), row.ravel().tolist(), strict=True))
    cells = cells[first]

    groups = []
    for dim, tag in gmsh.model.getPhysicalGroups():
        if dim > dimension:
            continue
        corners = dim + 1 if kind in ("tetrahedron", "triangle") else 2**dim
        parts: list[np.ndarray] = []
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            for kind_number, tags, nodes in zip(*mesh.getElements(dim, entity), strict=True):
                if dim == dimension:
                    parts.append(np.array([row_of_tag[t] for t in tags.tolist()], dtype=np.int64))
                    continue
                _, _, _, count, _, primary = mesh.getElementProperties(kind_number)
                if primary == corners:  # other shapes cannot be faces of these cells
                    nodes = np.asarray(nodes, dtype=np.int64).reshape(-1, count)[:, :corners]
                    nodes = nodes[np.isin(nodes, used).all(axis=1)]
                    parts.append(np.searchsorted(used, nodes))
        empty = np.empty(0 if dim == dimension else (0, corners), dtype=np.int64)
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        groups.append(PhysicalGroup(name, dim, tag, np.concatenate([empty, *parts])))

    tags, x, _ = mesh.getNodes()
    if not np.isin(used, tags).all():
        raise BadInput("its cells have nodes that are not in it")
    order = np.argsort(tags)
    x = x.reshape(-1, 3)[order[np.searchsorted(tags, used, sorter=order)]]
    if dimension == 2:
        if np.ptp(x[:, 2]) > FLAT * np.abs(x).max():
            raise BadInput(
                "it has no volume cells: mesh in 3 dimensions, and save all elements; or in the "
                "plane z = 0"
            )
        x = x[:, :2]
    return MeshData(cells, x, kind, degree, groups)
