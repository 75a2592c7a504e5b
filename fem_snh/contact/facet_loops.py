"""Compiled loops over the quadrature points of facets: contact_api.h for numpy arrays."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fem_snh.arrays import Array
from fem_snh.choices import POINT_FILTERS
from fem_snh.geometry.motions import Pose
from fem_snh.kernels import build
from fem_snh.kernels.build import cdata

if TYPE_CHECKING:
    from _cffi_backend import FFI, Lib


#: Facets: their indices, or a slice of all.
Which = Array | slice
ALL = slice(None)
#: A point slides where its stress is above this fraction of the limit: a point that slid is at the
#: limit when the next step starts, within rounding, and slides on.
YIELD = 1 - 1e-9


@functools.cache
def _library() -> tuple[FFI, Lib]:
    """Open the library, compiled unless the cache has it. Not collective."""
    return build.open_library(
        ["contact_api.h"],
        ["contact_kernels.h"],
        [f"#define YIELD {YIELD!r}", build.svd_eigen_declarations()],
        [build.svd_eigen_object()],
    )


def same(a: Array, b: Array) -> bool:
    """Return whether two arrays of float64 have the same shape and bits."""
    lib = _library()[1]
    return a is b or (a.shape == b.shape and bool(lib.same_values(a.size, cdata(a), cdata(b))))


def largest_move(nodes: Array, X: Array, u: Array, pose: Pose, before: Array) -> float:
    """Return how far the farthest of some nodes has moved relative to an obstacle [m].

    Parameters
    ----------
    nodes : (n,) int32
        Local nodes.
    X : (n, 3)
        Their reference coordinates [m].
    u : (local nodes, 3)
        Nodal displacements [m].
    pose : Pose
        The obstacle's pose.
    before : (n, 3)
        What ``pose.invert`` returned of their positions before.
    """
    arrays = map(cdata, (X, u, pose.rotation, pose.translation, before))
    square = _library()[1].largest_move(len(nodes), cdata(nodes, np.int32), *arrays)
    return float(square) ** 0.5


def response(
    rows: Array | None, k: Array, multipliers: Array, gap: Array, start: Array | None = None
) -> tuple[Array, Array, Array]:
    r"""Return energy [J/m^2], pressure [Pa] and stiffness [Pa/m], all of the shape of ``gap``.

    With the gaps :math:`g_0` at the start of a step they are those of the mean penalty pressure of
    the step, whose work is the loss of contact energy:

    .. math:: \bar p = \frac{p_1^2 - p_0^2}{2 k (g_0 - g_1)}

    with the pressures :math:`p_0, p_1` at the start and the end of the step (Hauret & Le Tallec
    2006). It is :math:`(p_0 + p_1)/2` at a point that is in contact at both, and less where contact
    begins or ends.

    Parameters
    ----------
    rows : (n,) int or None
        The rows of ``k`` and ``multipliers`` to which the gaps belong; None for all.
    k, multipliers : array
        Penalty stiffness [Pa/m] and multipliers [Pa], which means over a step ignore.
    gap : (n, ...)
        Gaps, of means those at the end of the step [m].
    start : (n, ...), optional
        Gaps at the start of the step [m].
    """
    ffi, lib = _library()
    found = np.empty((3, *gap.shape))
    n = len(gap) or 1
    lib.contact_response(
        len(gap), gap.size // n, ffi.NULL if rows is None else cdata(rows, np.int32), cdata(k),
        cdata(multipliers), ffi.NULL if start is None else cdata(start), cdata(gap),
        *map(cdata, found),
    )  # fmt: skip
    return found[0], found[1], found[2]


class FrictionAt(NamedTuple):
    """The struct ``Friction`` of contact_api.h: arrays of facets, or of m chosen facets.

    Attributes
    ----------
    stiffness : (facets,)
        Tangential stiffness [Pa/m].
    normal : (facets, points, 3)
        Lagged unit normals.
    limit : (m, points)
        The largest stress [Pa].
    offset : (m, points, 3)
        The slip without the displacement since the start of the step [m].
    """

    stiffness: Array
    normal: Array
    limit: Array
    offset: Array


class FacetLoops:
    """Loops over points of facets: quadrature points, or any others without weights.

    Methods get nodal displacements ``u`` (local nodes, 3) [m], ghosts included, and chosen facets
    ``which``, (m,) int or all.

    Parameters
    ----------
    nodes : (facets, k) int
        Local nodes of each facet.
    basis : (points, k)
        Shape functions at the points.
    X : (facets, points, 3)
        Reference coordinates of the points [m].
    weights : (facets, points), optional
        Quadrature weights [m^2].
    cell_nodes : (facets, k) int, optional
        Indices of the nodes among the nodes of the facet's cell.
    size : (components, nodes), optional
        Components of the displacement, and nodes of a cell.
    """

    def __init__(
        self,
        nodes: Array,
        basis: Array,
        X: Array,
        weights: Array | None = None,
        cell_nodes: Array | None = None,
        size: tuple[int, int] = (3, 0),
    ) -> None:
        ffi, self._lib = _library()
        self._num_facets, self._points = len(nodes), len(basis)
        self._components, self._dofs = size[0], size[0] * size[1]
        self._facets = ffi.new("Facets *")
        self._facets.points, self._facets.nodes = basis.shape
        self._facets.components, self._facets.cell_nodes = size
        # The struct holds pointers: the arrays must live as long.
        self._kept = [cdata(nodes, np.int32), cdata(basis), cdata(X)]
        self._facets.node, self._facets.basis, self._facets.X = self._kept
        if weights is not None and cell_nodes is not None:
            self._kept += [cdata(weights), cdata(cell_nodes, np.int32)]
            self._facets.weight, self._facets.cell_node = self._kept[3:]

    def vectors(self, u: Array, which: Which, deformed: bool) -> Array:
        """Return displacements, or deformed coordinates, at the points, (m, points, 3) [m]."""
        m, rows = self._chosen(which)
        y = np.empty((m, self._points, 3))
        self._lib.facet_vectors(self._facets, m, rows, cdata(u), deformed, cdata(y))
        return y

    def add_vectors(self, values: Array, which: Which, out: Array) -> None:
        """Add the sums of shape functions times vectors (m, points, size) to ``out`` (nodes, c)."""
        m, rows = self._chosen(which)
        sizes, target = (values.shape[2], out.shape[1]), build.pointer(_library()[0], out)
        self._lib.add_facet_vectors(self._facets, m, rows, cdata(values), *sizes, target)

    def contact_forces(self, which: Which, pressure: Array, normal: Array) -> Array:
        """Return the forces of pressures (m, points) and normals, (m, points, 3) [N]."""
        m, rows = self._chosen(which)
        force = np.empty((m, self._points, 3))
        columns = self._struct("NormalContact", pressure, pressure[:0], normal, normal[:0])
        self._lib.contact_forces(self._facets, m, rows, columns, cdata(force))
        return force

    def contact_matrices(
        self, which: Which, columns: tuple[Array, Array, Array, Array], filter: str, factor: float
    ) -> tuple[Array, Array, int]:
        """Return the rows of facets in contact (n,), their cells' Hessians (n, dofs, dofs) [N/m].

        ``columns`` are pressures, stiffnesses, normals and curvatures, as in ``NormalContact``; the
        Hessians are multiplied by ``factor``. The last value returned counts filtered points.
        """
        m, rows = self._chosen(which)
        K, acting = np.empty((m, self._dofs, self._dofs)), np.empty(m, np.int32)
        filtered = _library()[0].new("int *")
        count = self._lib.contact_matrices(
            self._facets, m, rows, self._struct("NormalContact", *columns),
            POINT_FILTERS.index(filter), factor, cdata(acting, np.int32), cdata(K), filtered,
        )  # fmt: skip
        return acting[:count], K[:count], filtered[0]

    def friction(self, which: Array, at: FrictionAt, u: Array) -> tuple[Array, Array, float]:
        """Return slips [m] and stresses [Pa] of friction, (m, points, 3) each, and its energy [J].

        ``u`` are displacements since the start of the step.
        """
        m, rows = self._chosen(which)
        slip, stress = np.empty((2, m, self._points, 3))
        columns = self._struct("Friction", *at)
        arrays = map(cdata, (u, slip, stress))
        energy = self._lib.friction_stresses(self._facets, m, rows, columns, *arrays)
        return slip, stress, float(energy)

    def friction_matrices(self, which: Array, at: FrictionAt, slip: Array) -> Array:
        """Return the Hessians of friction of the facets' cells, (m, dofs, dofs) [N/m]."""
        m, rows = self._chosen(which)
        K = np.empty((m, self._dofs, self._dofs))
        self._lib.friction_matrices(
            self._facets, m, rows, self._struct("Friction", *at), cdata(slip), cdata(K)
        )
        return K

    def _chosen(self, which: Which) -> tuple[int, Any]:
        """Return how many facets are chosen, and a pointer to their indices; NULL for all."""
        if isinstance(which, slice):
            return self._num_facets, _library()[0].NULL
        return len(which), cdata(which, np.int32)

    def _struct(self, name: str, *columns: Array) -> Any:
        """Return a struct of pointers, and keep these alive until the next struct."""
        self._columns = [*map(cdata, columns)]
        return _library()[0].new(f"{name} *", self._columns)
