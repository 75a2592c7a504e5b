"""dolfinx programs of two dimensions: meshes, conditions, and F in UFL for each kinematics."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import vector_space

import fem_snh

COMPONENTS = {"plane_strain": 2, "axisymmetric": 2, "axisymmetric_torsion": 3}
#: Elements with their cell.
ELEMENTS = {
    **dict.fromkeys(("P1", "P2", "P2P0", "P2P1"), "triangle"),
    **dict.fromkeys(("Q1", "Q1P0", "Q2", "Q2Q1"), "quadrilateral"),
}


def rectangle(comm: Any, element: str, low: Any, high: Any, cells: Any) -> Any:
    """Return dolfinx's own mesh of a rectangle, of the element's cells."""
    kind = getattr(mesh.CellType, ELEMENTS[element])
    return mesh.create_rectangle(comm, [np.array(low), np.array(high)], cells, kind)


def displacement(domain: Any, element: str, kinematics: str) -> Any:
    return fem.Function(vector_space(domain, int(element[1]), COMPONENTS[kinematics]))


def sides(V: Any, axis: int, at: float) -> np.ndarray:
    """Return the nodes on a straight side."""
    facets = mesh.locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[axis], at))
    return fem.locate_dofs_topological(V, 1, facets)


def prescribe(V: Any, axis: int, at: float, value: Any, components: Any = None) -> list[Any]:
    """Return conditions on a side: the rows of ``value(x)`` in some components or in all."""
    size = V.dofmap.index_map_bs
    x = V.tabulate_dof_coordinates().T
    function = fem.Function(V)
    rows = np.array([np.broadcast_to(row, x.shape[1]) for row in value(x)[:size]], float)
    function.x.array[:] = rows.T.ravel()
    if components is None:
        return [fem.dirichletbc(function, sides(V, axis, at))]
    facets = mesh.locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[axis], at))
    found = []
    for component in components:
        part = V.sub(component)
        space = part.collapse()[0]
        values = fem.Function(space)
        values.interpolate(lambda x, c=component: np.broadcast_to(value(x)[c], x.shape[1]))
        dofs = fem.locate_dofs_topological((part, space), 1, facets)
        found.append(fem.dirichletbc(values, dofs, part))
    return found


def zero(x: np.ndarray) -> np.ndarray:
    return np.zeros((3, 1))


def solve(u: Any, material: Any, bcs: Any, **keywords: Any) -> fem_snh.NonlinearProblem:
    """Return the solved problem of one material."""
    keywords.setdefault("petsc_options", {"snes_scaled_tol": 1e-12})
    problem = fem_snh.NonlinearProblem(u, {material: ufl.dx}, bcs=bcs, **keywords)
    problem.solve()
    assert problem.solver.getConvergedReason() > 0, problem.reason
    return problem


def clamped(
    comm: Any, kinematics: str, cells: int = 4, hold: bool = True, inner: float = 1.0
) -> Any:
    """Return a `Problem` on [1, 2] x [0, 1], whose inner side may be held, with its Hessian.

    ``inner`` is the first coordinate of the inner side.
    """
    element = "Q1"
    domain = rectangle(comm, element, (inner, 0), (inner + 1, 1), (cells, cells))
    u = displacement(domain, element, kinematics)
    bcs = prescribe(u.function_space, 0, inner, zero) if hold else []
    snh = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.4)
    made = fem_snh.NonlinearProblem(
        u, {snh: ufl.dx}, bcs=bcs, element=element, kinematics=kinematics
    )._problem
    nodes = made.coordinates @ np.array([[2.0, 5.0, 3.0], [3.0, 1.0, 4.0], [0.0, 0.0, 0.0]])
    made.x.array[:] = 0.05 * hold * np.sin(nodes[:, : COMPONENTS[kinematics]]).ravel()
    made.prescribe(made.x)
    made.jacobian(made.x, "clamp")
    return made


def deformation(u: Any, kinematics: str) -> tuple[Any, Any]:
    """Return F and the weight of dx, from the textbook (Ogden 1997, section 1.5.6)."""
    if kinematics == "plane_strain":
        g = ufl.grad(u)
        return ufl.as_matrix([[1 + g[0, 0], g[0, 1], 0], [g[1, 0], 1 + g[1, 1], 0], [0, 0, 1]]), 1.0
    r = ufl.SpatialCoordinate(u.function_space.mesh)[0]
    t, slopes = 0, [0, 0]
    if kinematics == "axisymmetric_torsion":
        t, slopes = u[2], [u[2].dx(0), u[2].dx(1)]
    rows = [
        [1 + u[0].dx(0), u[0].dx(1), -t / r],
        [u[1].dx(0), 1 + u[1].dx(1), 0],
        [*slopes, 1 + u[0] / r],
    ]
    return ufl.as_matrix(rows), 2 * ufl.pi * r


SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.45)


def motion(u, kinematics, integrator="newmark", density=2.0, **keywords):
    """The motion of a body of one material."""
    keywords.setdefault("petsc_options", {"snes_scaled_tol": 1e-12})
    return fem_snh.DynamicProblem(
        u, {SNH: ufl.dx}, {SNH: density}, integrator, kinematics=kinematics, **keywords
    )
