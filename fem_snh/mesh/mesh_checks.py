"""Check the geometry of a mesh: its coordinates, its size, its cells and how they meet."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput

#: Scaled Jacobian below which a cell is degenerate: far above rounding, far below any usable cell.
_MIN_SCALED_JACOBIAN = 1e-10
#: Smallest scale of forces [N], and inverse of the largest: squares of residuals 1e-16 times the
#: scale, and sums of these squares, are normal numbers.
_SMALLEST_FORCE = 1e-100
#: A node is on the axis of revolution if its radius is at most this part of the largest coordinate.
ON_AXIS = 1e-12
#: Vertices coincide if they round to the same multiple of this fraction of the largest coordinate:
#: far above the rounding of mesh files, far below any usable cell.
_SAME_PLACE = 1e-9
#: Degree of the lattice on which the Jacobian of curved cells is evaluated: it is a polynomial of
#: degree 3 on tetrahedra, and of degree 5 in each direction on hexahedra.
_LATTICE = 5
#: Cells per batch, which bounds the memory.
_BATCH = 10_000


def check_geometry(domain: _dolfinx.Mesh, what: str, may_overlap: bool = False) -> None:
    """Check the coordinates, the cells and the neighbours of a dolfinx mesh. Collective.

    The numbering of a cell's vertices may be left-handed. Neighbours, however, must lie on opposite
    sides of their common facet: otherwise the mesh overlaps itself, and the sum of the cell volumes
    is not the body's volume.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    what : str
        The mesh's name in the message.
    may_overlap : bool
        Accept neighbours that overlap: parts of a body in a lattice may coincide.

    Raises
    ------
    BadInput
        On every rank: coordinates that are not finite or whose size is out of range, degenerate
        cells, cells whose Jacobian changes its sign, and neighbours that overlap.
    """
    x = _dolfinx.geometry_x(domain)
    _raise_for(domain, what, ~np.isfinite(x).all(axis=1), x, "nodes without finite coordinates")
    size = largest(domain.comm, x)
    if not 1 / LARGEST_NUMBER <= size <= LARGEST_NUMBER:
        raise BadInput(
            f"{what}: its largest coordinate is {size:.3g}: expected one from "
            f"{1 / LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}"
        )
    centres = x[_dolfinx.geometry_dofs(domain)[:, : len(_corners(domain))]].mean(axis=1)
    bad = scaled_jacobian(domain) < _MIN_SCALED_JACOBIAN
    _raise_for(domain, what, bad, centres, "inverted or degenerate cells")
    if not may_overlap:
        bad = _cells_on_the_wrong_side(domain)
        _raise_for(domain, what, bad, centres, "cells that overlap a neighbour")


def check_half_plane(domain: _dolfinx.Mesh, what: str) -> None:
    """Raise BadInput on every rank if a mesh to be revolved has points with x < 0. Collective."""
    x = _dolfinx.geometry_x(domain)
    size = largest(domain.comm, x)
    bad = x[:, 0] < -ON_AXIS * size
    _raise_for(domain, what, bad, x, "nodes with a negative radius x")


def check_force_scale(force: float) -> None:
    """Raise BadInput for a scale of forces [N] whose squares overflow or underflow."""
    if not _SMALLEST_FORCE <= force <= 1 / _SMALLEST_FORCE:
        raise BadInput(
            f"E V^(2/3) = {force:.3g}: expected a force from {_SMALLEST_FORCE:g} to "
            f"{1 / _SMALLEST_FORCE:g}: choose other units of length or stress"
        )


def unconnected_nodes(domain: _dolfinx.Mesh) -> tuple[int, Array]:
    """Count the positions at which several boundary vertices coincide. Collective.

    Cells on both sides are not connected there: two volumes were meshed without a common surface,
    or the body has a slit.

    Returns
    -------
    count : int
        The number of positions.
    first : (3,) array
        One of the positions [m]; NaN if there are none.
    """
    _, cells, local = _dolfinx.exterior_facets(domain)
    at = cells[:, None], _dolfinx.reference_facets(_dolfinx.cell_name(domain))[local]
    vertices = _dolfinx.cell_vertices(domain)[at].ravel()
    unit = _SAME_PLACE * largest(domain.comm, _dolfinx.geometry_x(domain))
    nodes = _dolfinx.geometry_dofs(domain)[at].ravel()
    place = np.rint(_dolfinx.geometry_x(domain)[nodes] / unit).astype(np.int64)
    own = np.unique(np.column_stack([place, vertices]), axis=0)
    of_all = np.unique(np.concatenate(domain.comm.allgather(own)), axis=0)
    places, counts = np.unique(of_all[:, :3], axis=0, return_counts=True)
    several = places[counts > 1]
    return len(several), several[0] * unit if len(several) else np.full(3, np.nan)


def largest(comm: MPI.Intracomm, values: Array) -> float:
    """Return the largest absolute value on all ranks; 0 without values. Collective."""
    return float(comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX))


def _raise_for(domain: _dolfinx.Mesh, what: str, bad: Array, points: Array, kind: str) -> None:
    """Raise BadInput on every rank if an entry of ``bad`` is True on any rank. Collective.

    The message has the number of bad entries, ``kind``, and the first bad entry of ``points``.
    """
    counts = domain.comm.allreduce(np.array([bad.sum(), len(bad)]))
    if not counts[0]:
        return
    first = points[np.flatnonzero(bad)[:1]].tolist()
    first = next(place[0] for place in domain.comm.allgather(first) if place)
    where = ", ".join(f"{value:.6g}" for value in first)
    raise BadInput(f"{what} has {counts[0]} {kind} of {counts[1]}, one at ({where})")


def scaled_jacobian(domain: _dolfinx.Mesh) -> np.ndarray:
    """Return the scaled Jacobian of each cell, (owned cells,); <= 0 where a cell is inverted.

    It is the smallest value over a cell's corners and midpoint, and for a curved cell over further
    lattice points. The value at a corner is the volume of the parallelepiped (area of the
    parallelogram) of the edges over the product of their lengths: 1 for a cube, 0.707 for a regular
    tetrahedron. A left-handed cell is valid if the sign is the same everywhere.
    """
    cell, corners = _dolfinx.cell_name(domain), _corners(domain)
    dim = corners.shape[1]
    edges = corners - corners[:, None]  # from each corner to each
    nearest = np.sort(np.linalg.norm(edges, axis=2).argsort(axis=1)[:, 1 : dim + 1], axis=1)
    edges = np.take_along_axis(edges, nearest[:, :, None], axis=1)
    points = [corners, corners.mean(axis=0)[None]]
    if _dolfinx.geometry_degree(domain) > 1:
        points.append(_dolfinx.reference_nodes(cell, _LATTICE)[len(corners) :])
    inside = sum(map(len, points[1:]))
    edges = np.concatenate([edges, np.tile(np.eye(dim), (inside, 1, 1))])
    gradients = _dolfinx.tabulate_geometry(domain, np.concatenate(points))
    if cell in ("tetrahedron", "triangle") and _dolfinx.geometry_degree(domain) == 1:
        gradients = gradients[:1]  # the same at all points
    x, cells = _dolfinx.geometry_x(domain)[:, :dim], _dolfinx.geometry_dofs(domain)
    worst = np.empty(len(cells))
    for start in range(0, len(cells), _BATCH):
        chunk = slice(start, start + _BATCH)
        jacobian = np.einsum("cni,pnj->cpij", x[cells[chunk]], gradients, optimize=True)
        # Relative to the cell's size: products of three lengths neither overflow nor underflow.
        size = np.abs(jacobian).max(axis=(1, 2, 3), keepdims=True)
        jacobian /= np.where(size > 0, size, 1.0)
        tangents = np.einsum("cpij,pkj->cpik", jacobian, edges)
        lengths = np.sqrt(np.einsum("cpik,cpik->cpk", tangents, tangents)).prod(axis=2)
        # No LU factors as of numpy.linalg.det: they overflow for tiny numbers.
        volumes = _determinants(np.moveaxis(jacobian, 2, 0))
        scaled = volumes / np.maximum(lengths, np.finfo(float).tiny)
        worst[chunk] = np.maximum(scaled.min(axis=1), -scaled.max(axis=1))
    return worst


def _determinants(rows: Array) -> Array:
    """Return the determinants (...) of matrices from their rows, (dim, ..., dim)."""
    if len(rows) == 2:
        (a, b), (c, d) = (np.moveaxis(row, -1, 0) for row in rows)
        return np.asarray(a * d - b * c)
    a, b, c = rows
    return np.asarray(np.einsum("...i,...i->...", a, np.cross(b, c)))


def _corners(domain: _dolfinx.Mesh) -> Array:
    """Return the corners of the reference cell, (corners, dim)."""
    return _dolfinx.reference_corners(_dolfinx.cell_name(domain))


def _cells_on_the_wrong_side(domain: _dolfinx.Mesh) -> Array:
    """Return which owned cells lie on the same side of a facet as their neighbour. Collective."""
    facets, sides = _dolfinx.cell_facets(domain), _sides(domain)
    # An interior facet has two cells, with sides +1 and -1; one of them may be on another rank.
    count = np.bincount(facets.ravel())
    total = np.bincount(facets.ravel(), weights=sides.ravel())
    bad = (count > 2) | ((count == 2) & (total != 0))
    if domain.comm.size > 1:
        count[_dolfinx.exterior_facets(domain)[0]] = 0
        cell, local = np.nonzero(count[facets] == 1)
        table = _dolfinx.reference_facets(_dolfinx.cell_name(domain))
        vertices = _dolfinx.cell_vertices(domain)[cell[:, None], table[local]]
        rows = np.column_stack([np.sort(vertices, axis=1), sides[cell, local].astype(np.int64)])
        # This rank's facets come first.
        of_ranks = domain.comm.allgather(rows)
        all_rows = np.concatenate([of_ranks.pop(domain.comm.rank), *of_ranks])
        facet = np.unique(all_rows[:, :-1], axis=0, return_inverse=True)[1].ravel()
        number, total = np.bincount(facet), np.bincount(facet, weights=all_rows[:, -1])
        overlaps = (number > 2) | ((number == 2) & (total != 0))
        bad[facets[cell, local]] |= overlaps[facet[: len(rows)]]
    return np.asarray(bad[facets].any(axis=1))


def _sides(domain: _dolfinx.Mesh) -> Array:
    """Return on which side of each of its facets a cell lies, (cells, facets), +1 or -1.

    The side in the reference cell changes its sign with the Jacobian, and if the facet's vertices
    are in the opposite order of their global numbers, which both cells share.
    """
    cell = _dolfinx.cell_name(domain)
    middle = _corners(domain).mean(axis=0)
    origins, tangents = _dolfinx.facet_maps(cell)
    reference = np.linalg.det(np.concatenate([tangents, (middle - origins)[:, None]], axis=1))
    gradients = _dolfinx.tabulate_geometry(domain, middle[None])[0]
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain), : len(middle)]
    jacobians = np.einsum("cni,nj->cij", x, gradients)
    # Relative to the cell's size: products of three lengths neither overflow nor underflow.
    jacobians /= np.abs(jacobians).max(axis=(1, 2), keepdims=True, initial=np.finfo(float).tiny)
    sides = np.sign(np.linalg.det(jacobians))[:, None] * np.sign(reference)
    return np.asarray(np.where(_dolfinx.facet_reflections(domain), -sides, sides))
