"""The objects of a user's dolfinx program (mesh, space, conditions), made by dolfinx alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh

import fem_snh


def unit_cube(comm: Any, cells: int = 3, cell: str = "hexahedron") -> Any:
    """Return dolfinx's own mesh of the unit cube, on several ranks with its ghost cells."""
    kind = getattr(mesh.CellType, cell)
    return mesh.create_unit_cube(comm, cells, cells, cells, kind)


def vector_space(domain: Any, degree: int = 1, components: int = 3) -> Any:
    """Return a Lagrange space, by the function that this version of dolfinx has."""
    if hasattr(fem, "functionspace"):
        return fem.functionspace(domain, ("Lagrange", degree, (components,)))
    return fem.VectorFunctionSpace(domain, ("CG", degree), dim=components)


def halves(domain: Any) -> Any:
    """Return meshtags of the cells: 1 where their midpoint has x < 1/2, else 2."""
    count = domain.topology.index_map(3).size_local + domain.topology.index_map(3).num_ghosts
    values = np.full(count, 2, np.int32)
    values[mesh.locate_entities(domain, 3, lambda x: x[0] < 0.5 + 1e-9)] = 1
    return mesh.meshtags(domain, 3, np.arange(count, dtype=np.int32), values)


class Press:
    """A cube whose bottom is fixed and whose top is pressed down.

    ``top`` is the prescribed displacement of the top, a Function.
    """

    def __init__(self, domain: Any, degree: int = 1, height: float = -0.3) -> None:
        V = vector_space(domain, degree)
        self.domain, self.V, self.u, self.top = domain, V, fem.Function(V), fem.Function(V)
        self.top.x.array[2::3] = height
        self.bcs = [
            fem.dirichletbc(np.zeros(3), self.dofs(2, 0.0), V),
            fem.dirichletbc(self.top, self.dofs(2, 1.0)),
        ]
        self.F = ufl.Identity(3) + ufl.grad(self.u)

    def dofs(self, axis: int, at: float) -> np.ndarray:
        """Return the nodes of a face."""
        facets = mesh.locate_entities_boundary(self.domain, 2, lambda x: np.isclose(x[axis], at))
        return fem.locate_dofs_topological(self.V, 2, facets)


class Bar(Press):
    """A cube with rollers at x = 0, y = 0 and z = 0, stretched in x by the Constant ``pull``."""

    def __init__(self, domain: Any, degree: int = 1, pull: float = 0.5) -> None:
        super().__init__(domain, degree)
        self.pull = fem.Constant(domain, pull)
        fixed = fem.Constant(domain, 0.0)
        self.bcs = [
            *(self.roller(fixed, axis, 0.0) for axis in range(3)),
            self.roller(self.pull, 0, 1.0),
        ]

    def roller(self, value: Any, axis: int, at: float) -> Any:
        facets = mesh.locate_entities_boundary(self.domain, 2, lambda x: np.isclose(x[axis], at))
        component = self.V.sub(axis)
        return fem.dirichletbc(value, fem.locate_dofs_topological(component, 2, facets), component)


def converged(problem: fem_snh.NonlinearProblem) -> bool:
    return problem.solver.getConvergedReason() > 0


def tagged_measure(kind: str, domain: Any, places: Any) -> Any:
    """Return dx, or ds, whose tags 1, 2, ... are the entities in places; the last one wins."""
    dim = domain.topology.dim - (kind == "ds")
    found = [mesh.locate_entities(domain, dim, place) for place in places]
    if kind == "ds":
        outside = mesh.locate_entities_boundary(domain, dim, lambda x: x[0] == x[0])
        found = [np.intersect1d(entities, outside) for entities in found]
    tags = {int(i): tag for tag, some in enumerate(found, 1) for i in some}
    items = np.array(sorted(tags), np.int32)
    values = np.array([tags[i] for i in items], np.int32)
    data = mesh.meshtags(domain, dim, items, values)
    return ufl.Measure(kind, domain=domain, subdomain_data=data)
