"""The unknowns of a problem: displacement, pressure, their ghosted vectors and rigid motions.

Both classes hold the solver's vector ``x``, whose first owned entries are the displacements, node
by node. They convert between vectors like ``x`` and the ghosted vectors of the separate fields.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.elements import Element
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.geometry.rotations import rigid_displacements
from fem_snh.mesh.mesh import point_volumes

#: Weight of the volume errors of cells relative to strains. A larger weight saves Newton iterations
#: and costs linear iterations (docs/results/elements_cell_pressures.md).
_VOLUME_WEIGHT = 3.0
#: Thickness of a layer of nodes, in mean distances of nodes: with 1, planes of nodes share layers
#: on meshes that are finer along the body; with 2, sweeps take a tenth more iterations.
_LAYER = 0.5


def num_unknowns(domain: _dolfinx.Mesh, element: Element) -> int:
    """Return the number of displacements and pressures of an element on a mesh. Collective."""
    displacements, pressures = (
        _dolfinx.num_nodes_of_degree(domain, degree)
        for degree in (element.degree, element.pressure_degree)
    )
    return element.kinematics.components * displacements + element.has_pressure * pressures


def displacement_space(
    domain: _dolfinx.Mesh, degree: int = 1, components: int | None = None
) -> FunctionSpace:
    """Return a space of vectors whose nodes are numbered along the body. Collective.

    Each rank's own nodes are in layers across their longest extent, those of a layer in lines: in
    this order the sweeps of the linear solver take fewer iterations than in dolfinx's
    (docs/theory/linear_solver.md).

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    degree : int
        Degree of the Lagrange element.
    components : int, optional
        Components of the vectors, 2 or 3. Default: the dimension of the mesh.
    """
    dim = domain.geometry.dim
    V = _dolfinx.function_space(domain, degree, (components or dim,))
    owned = _dolfinx.num_nodes(V)[0]
    X = V.tabulate_dof_coordinates()[:owned, :dim]
    axes = np.ptp(X, axis=0).argsort() if owned else slice(None)  # lexsort's last key comes first
    volume = point_volumes(domain, degree=1).sum() or 1.0
    layer = _LAYER * (volume / max(owned, 1)) ** (1 / dim)
    numbers = np.empty(owned, np.int64)
    order = np.lexsort(np.round(X[:, axes] / layer).T)
    numbers[order] = _dolfinx.local_to_global(V)[:owned]
    return _dolfinx.renumbered(V, numbers_with_ghosts(V, numbers))


def space_for(domain: _dolfinx.Mesh, element: Element, components: int) -> FunctionSpace:
    """Return the displacement's space of an element. Collective.

    `displacement_space` from degree 2 on; with degree 1 it saves no iterations. With pressures of
    cells or nodes dolfinx's numbers are kept: in another order MUMPS takes other pivots for null
    where an unknown pressure has no level, and Newton's method may not converge.
    """
    if element.degree == 1 or element.volume != "pointwise":
        return _dolfinx.function_space(domain, element.degree, (components,))
    return displacement_space(domain, element.degree, components)


class Displacement:
    """The displacement is the only unknown: ``x`` is the ghosted vector of the function ``u``.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m], of a Lagrange space.

    Attributes
    ----------
    V : dolfinx function space
        The displacement's space.
    x : PETSc.Vec
        The solver's vector.
    num_owned_nodes : int
        Number of displacement nodes that this rank owns.
    components : int
        Displacement components of a node.
    Q : dolfinx function space or None
        The pressure's space; None without a pressure.
    """

    Q: _dolfinx.FunctionSpace = None

    def __init__(self, u: _dolfinx.Function) -> None:
        self.u, self.V = u, u.function_space
        self.x = _dolfinx.petsc_vec(u)
        self.num_owned_nodes = _dolfinx.num_nodes(self.V)[0]
        self.components = _dolfinx.num_components(self.V)

    def split(self, x: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec | None]:
        """Return the ghosted vectors (displacement, pressure or None) of ``x``. Collective.

        Ghosts are updated. The displacement is ``x`` itself; in `DisplacementPressure` the vectors
        are the memory of ``u`` and ``p``, which is overwritten.
        """
        update_ghosts(x)
        return x, None

    @contextmanager
    def kept_fields(self) -> Iterator[None]:
        """Restore on exit the values of ``u`` and ``p`` that `split` overwrites."""
        yield

    @contextmanager
    def residual(self, r: PETSc.Vec) -> Iterator[tuple[PETSc.Vec, PETSc.Vec | None]]:
        """Yield zero ghosted vectors (dE/du, dE/dp or None) to add to; on exit ``r`` is their sum.

        Contributions to ghost entries are added on the ranks that own the entries. Collective.
        """
        set_to_zero(r)
        yield r, None
        add_ghosts(r)


class DisplacementPressure(Displacement):
    """Displacement and pressure are unknowns (Taylor-Hood, or one pressure in each cell).

    The pressure in ``x`` is divided by a unit [Pa/m], such as E/L: it is a length, like the
    displacement, so that both parts of the residual are forces.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m].
    pressure_degree : int
        Degree of the pressure's Lagrange space; 0: constant in each cell, discontinuous.

    Attributes
    ----------
    pressure : PETSc.Vec
        The ghosted pressures [m] of the last call of `split`.
    index_sets : dict of PETSc.IS
        {"u": IS, "p": IS}, the global dofs of each field on this rank.
    """

    def __init__(self, u: _dolfinx.Function, pressure_degree: int) -> None:
        super().__init__(u)
        domain = self.V.mesh
        family = "Lagrange" if pressure_degree else "DG"
        self.Q = _dolfinx.function_space(domain, pressure_degree, family=family)
        self.p = _dolfinx.function(self.Q, "pressure")
        self.pressure = _dolfinx.petsc_vec(self.p)
        self._r_u, self._r_p = (_dolfinx.create_vector(space) for space in (self.V, self.Q))
        self._num_u = self.components * self.num_owned_nodes
        num_p = _dolfinx.num_nodes(self.Q)[0]
        comm = domain.comm
        self.x = PETSc.Vec().createMPI((self._num_u + num_p, None), comm=comm)
        first = self.x.getOwnershipRange()[0]
        u = PETSc.IS().createStride(self._num_u, first, 1, comm=comm)
        u.setBlockSize(self.components)
        p = PETSc.IS().createStride(num_p, first + self._num_u, 1, comm=comm)
        self.index_sets = {"u": u, "p": p}

    def split(self, x: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec | None]:
        values, u = x.array_r, _dolfinx.petsc_vec(self.u)
        u.array[:] = values[: self._num_u]
        self.pressure.array[:] = values[self._num_u :]
        for vector in (u, self.pressure):
            update_ghosts(vector)
        return u, self.pressure

    @contextmanager
    def kept_fields(self) -> Iterator[None]:
        fields = self.u.x.array, self.p.x.array
        before = [values.copy() for values in fields]
        yield
        for values, kept in zip(fields, before, strict=True):
            values[:] = kept

    @contextmanager
    def residual(self, r: PETSc.Vec) -> Iterator[tuple[PETSc.Vec, PETSc.Vec | None]]:
        for vector in (self._r_p, self._r_u):
            set_to_zero(vector)
        yield self._r_u, self._r_p
        for vector in (self._r_u, self._r_p):
            add_ghosts(vector)
        r.array[: self._num_u] = self._r_u.array_r
        r.array[self._num_u :] = self._r_p.array_r

    def pressure_dofs(self, x: PETSc.Vec) -> np.ndarray:
        """Return a writable view of the owned pressure dofs [m] in ``x``."""
        return np.asarray(x.array[self._num_u :])


def pressure_unit(element: Element, num_cells: int) -> float:
    """Return the unit of the pressure unknown as a multiple of E/L.

    The unit weighs the pressure's residual against the displacement's. For cell pressures it
    depends on the size h of a cell: the forces of a strain are E h^2, and the residual of a volume
    error is the unit times h^3; in the plane, E h and the unit times h^2.
    """
    if element.volume != "cell_pressure":
        return 1.0
    return float(_VOLUME_WEIGHT * num_cells ** (1 / element.kinematics.dim))


def create_unknowns(u: _dolfinx.Function, element: Element) -> Displacement:
    """Return the unknowns: the displacement ``u``, and a pressure if the element has one."""
    if not element.has_pressure:
        return Displacement(u)
    return DisplacementPressure(u, element.pressure_degree)


def ghosted(V: FunctionSpace, owned: Array) -> PETSc.Vec:
    """Return a new ghosted vector with these owned values and updated ghosts. Collective."""
    vector = _dolfinx.create_vector(V)
    vector.array[:] = owned
    update_ghosts(vector)
    return vector


def with_ghosts(V: FunctionSpace, owned: Array) -> Array:
    """Return a copy of owned dofs' values, followed by the ghosts' values. Collective."""
    vector = ghosted(V, owned)  # keeps the memory of the values
    return np.array(local_values(vector))


def numbers_with_ghosts(V: FunctionSpace, owned: Array) -> Array:
    """Return a copy of owned nodes' whole numbers, followed by the ghosts' numbers. Collective."""
    components = _dolfinx.num_components(V)
    local = with_ghosts(V, np.repeat(owned, components)).reshape(-1, components)
    return local[:, 0].astype(np.int64)


def owned_sums(V: FunctionSpace, values: Array) -> Array:
    """Return owned dofs' sums over the ranks of values at local dofs. Collective."""
    vector = _dolfinx.create_vector(V)
    writable_values(vector)[:] = values
    add_ghosts(vector)
    return np.array(vector.array_r)


def summed_over_ranks(V: FunctionSpace, values: Array) -> Array:
    """Return the sums over ranks of values at local nodes, ghosts included. Collective.

    Parameters
    ----------
    V : dolfinx function space
    values : (local nodes, components) array
        This rank's part of the sums.

    Returns
    -------
    (local nodes, components) array
    """
    return with_ghosts(V, owned_sums(V, values.ravel())).reshape(values.shape)


def summed_over_cells(V: FunctionSpace, values: Array, nodes: Array | None = None) -> Array:
    """Return the sums over cells of values at their nodes, ghosts included. Collective.

    Parameters
    ----------
    V : dolfinx function space
    values : (cells, nodes, components) array
        The values at the nodes of this rank's cells.
    nodes : (cells, nodes) int, optional
        The local nodes of these cells. Default: the nodes of all owned cells.

    Returns
    -------
    (local nodes, components) array
    """
    sums = np.zeros((sum(_dolfinx.num_nodes(V)), _dolfinx.num_components(V)))
    np.add.at(sums, _dolfinx.node_dofs(V) if nodes is None else nodes, values)
    return summed_over_ranks(V, sums)


def nodes_of_other_cells(V: FunctionSpace, cells: Array) -> Array:
    """Return which owned nodes belong to a cell that is in no rank's ``cells``. Collective.

    Parameters
    ----------
    V : dolfinx function space
    cells : (n,) int
        Owned cells of this rank.

    Returns
    -------
    (owned nodes,) bool
    """
    nodes = np.delete(_dolfinx.node_dofs(V), cells, axis=0)
    marks = summed_over_cells(V, np.ones((*nodes.shape, 1)), nodes)
    return np.asarray(marks[: _dolfinx.num_nodes(V)[0], 0] > 0)


def local_values(vector: PETSc.Vec) -> Array:
    """Return a read-only view of a ghosted vector, ghosts included, valid while it exists."""
    with vector.localForm() as local:
        return np.asarray(local.array_r)


def writable_values(vector: PETSc.Vec) -> Array:
    """Return a writable view of a ghosted vector, ghosts included, valid while it exists."""
    with vector.localForm() as local:
        return np.asarray(local.array)


def copy_to_function(vector: PETSc.Vec, function: _dolfinx.Function) -> None:
    """Copy a ghosted vector to a dolfinx function of the same space, ghosts included."""
    function.x.array[:] = local_values(vector)


def set_to_zero(vector: PETSc.Vec) -> None:
    """Set a ghosted vector to zero, ghosts included."""
    with vector.localForm() as local:
        local.set(0.0)


def update_ghosts(vector: PETSc.Vec) -> None:
    """Copy owned values to the ghosts of other ranks. Collective."""
    vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)


def add_ghosts(vector: PETSc.Vec) -> None:
    """Add ghost values to the entries of the owning ranks. Collective."""
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)


def rigid_motions(
    comm: MPI.Intracomm,
    coordinates: np.ndarray,
    project: Callable[[np.ndarray], None],
    kinematics: Kinematics = SOLID,
) -> PETSc.NullSpace:
    """Return the projected rigid motions of a displacement, orthonormalised. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The communicator of the mesh.
    coordinates : (n, 3) array
        Reference coordinates of the nodes that this rank owns.
    project : callable
        Sets nodal displacements (components * n,) to zero in constrained directions, in place.
    kinematics : Kinematics, optional
        Which motions there are: six in a solid, three in a plane, and of a body of revolution the
        translation along its axis and, with torsion, the rotation about it.
    """
    basis, motions = [], rigid_displacements(coordinates)[:, :, : kinematics.components]
    for k in (0, 3, 1, 4, 2, 5):
        if not kinematics.rigid_motions[k]:
            continue
        motion = motions[k]
        vector = PETSc.Vec().createMPI((motion.size, None), bsize=motion.shape[1], comm=comm)
        vector.array[:] = motion.ravel()
        project(vector.array)
        basis.append(vector)
    for i, vector in enumerate(basis):
        for other in basis[:i]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    return PETSc.NullSpace().create(vectors=basis, comm=comm)
