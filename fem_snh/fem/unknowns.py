"""What is solved for: the displacement alone, or displacement and pressure.

Both hold the solver's vector ``x``, whose first owned entries are the displacement's (3 a node),
and lend the elastic term the fields that belong to any such vector.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.fem.elements import Element
from fem_snh.fem.mesh import Mesh
from fem_snh.fem.numbering import Layout, Space


def rigid_motions(comm: MPI.Intracomm, places: np.ndarray, free: np.ndarray) -> PETSc.NullSpace:
    """The six rigid motions of this rank's nodes at ``places`` (n, 3), orthonormal. Collective.

    ``free`` (n, 3) is 0 where they are zero, else 1.
    """
    basis = []
    for axis in np.eye(3):
        for motion in (np.tile(axis, (len(places), 1)), np.cross(axis, places)):
            vector = PETSc.Vec().createMPI((places.size, None), bsize=3, comm=comm)
            vector.array[:] = (motion * free).ravel()
            basis.append(vector)
    for i, vector in enumerate(basis):
        for other in basis[:i]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    return PETSc.NullSpace().create(vectors=basis, comm=comm)


class Displacement:
    """The displacement is unknown: ``x`` is the ghosted vector of the function ``u``."""

    def __init__(self, mesh: Mesh, element: Element) -> None:
        self.V = _dolfinx.function_space(mesh.domain, element.degree, (3,))
        self.u = _dolfinx.function(self.V, "displacement")
        self.x = _dolfinx.petsc_vec(self.u)
        self.owned, ghosts = _dolfinx.num_nodes(self.V)
        self.nodes = self.owned + ghosts

    def layout(self) -> Layout:
        """How the matrix numbers the unknowns."""
        return Layout(self.V.mesh.comm, [space(self.V, 3)])

    def displacement(self, x: PETSc.Vec) -> PETSc.Vec:
        """The ghosted displacement in ``x``."""
        x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        return x

    def begin_residual(self, r: PETSc.Vec) -> PETSc.Vec:
        """A ghosted vector, zero, to which the terms add."""
        with r.localForm() as local:
            local.set(0.0)
        return r

    def end_residual(self, r: PETSc.Vec) -> None:
        """Put what was added, summed over the ranks, into ``r``."""
        r.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)


class DisplacementPressure(Displacement):
    """Displacement and pressure are unknown (Taylor-Hood).

    The unknown in ``x`` is pressure / ``scale``, scale = E/L [Pa/m]: it is then a length, as the
    displacement is, and the residual's other half a force.

    Attributes
    ----------
    Q : the pressure's space; ``pressure`` its ghosted vector, in units of ``scale``.
    index_sets : {"u": IS, "p": IS}, the unknowns of each in the global numbering.
    """

    def __init__(self, mesh: Mesh, element: Element) -> None:
        super().__init__(mesh, element)
        self.Q = _dolfinx.function_space(mesh.domain, element.pressure_degree)
        self.p = _dolfinx.function(self.Q, "pressure")
        self.pressure = _dolfinx.petsc_vec(self.p)
        self.owned_pressures = _dolfinx.num_nodes(self.Q)[0]
        self._r_u, self._r_p = (_dolfinx.create_vector(space) for space in (self.V, self.Q))
        self._split = 3 * self.owned
        comm = mesh.domain.comm
        size = self._split + self.owned_pressures
        self.x = PETSc.Vec().createMPI((size, None), comm=comm)
        first = self.x.getOwnershipRange()[0]
        u = PETSc.IS().createStride(self._split, first, 1, comm=comm)
        u.setBlockSize(3)
        p = PETSc.IS().createStride(self.owned_pressures, first + self._split, 1, comm=comm)
        self.index_sets = {"u": u, "p": p}

    @property
    def residual_pressure(self) -> PETSc.Vec:
        """The ghosted vector to which the elastic term adds dE/dp."""
        return self._r_p

    def layout(self) -> Layout:
        return Layout(self.V.mesh.comm, [space(self.V, 3), space(self.Q, 1)])

    def displacement(self, x: PETSc.Vec) -> PETSc.Vec:
        """The ghosted displacement in ``x``; ``pressure`` follows."""
        values, u = x.array_r, _dolfinx.petsc_vec(self.u)
        u.array[:] = values[: self._split]
        self.pressure.array[:] = values[self._split :]
        for vector in (u, self.pressure):
            vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        return u

    def begin_residual(self, r: PETSc.Vec) -> PETSc.Vec:
        super().begin_residual(self._r_p)
        return super().begin_residual(self._r_u)

    def end_residual(self, r: PETSc.Vec) -> None:
        super().end_residual(self._r_u)
        super().end_residual(self._r_p)
        r.array[: self._split] = self._r_u.array_r
        r.array[self._split :] = self._r_p.array_r

    def pressure_dofs(self, x: PETSc.Vec) -> np.ndarray:
        """The owned pressures in ``x``, to read or to write, in units of ``scale``."""
        return np.asarray(x.array[self._split :])


def space(V: Any, size: int) -> Space:
    """A dolfinx space with ``size`` unknowns a node, as matrices are made for it."""
    return Space(_dolfinx.node_dofs(V), _dolfinx.num_nodes(V)[0], _dolfinx.local_to_global(V), size)


def create(mesh: Mesh, element: Element) -> Displacement:
    """The unknowns of an element."""
    kind = DisplacementPressure if element.volume == "pressure" else Displacement
    return kind(mesh, element)
