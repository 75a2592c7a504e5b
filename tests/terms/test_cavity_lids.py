"""Cavities that rigid parts close: the lid's area counts as that of facets."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import tagged_measure, vector_space
from gmsh_files import section
from plane_programs import COMPONENTS
from plane_scenes import solve
from rectangles import rectangle
from rigid_bodies import check_derivatives

import fem_snh
from fem_snh.assembly.unknowns import update_ghosts

TIGHT = {"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-10}
E, CELLS = 1.0, 4
#: A box whose upper quarter is rigid; a surface "whole" has its facets, "walls" ends at them.
WHOLE, WALLS = (1, 2), 1


def unsolved_box(comm, kinematics, degree, surface, planes=(), part=None, top=()):
    """Return the problem of a box on a fixed bottom that a fluid around it compresses.

    Its upper quarter is a rigid ``part``. Planes of symmetry are the sides at 0 along axes
    ``planes``; ``top`` is the displacement of the upper end.
    """
    dim = 2 if kinematics in COMPONENTS else 3
    create = mesh.create_rectangle if dim == 2 else mesh.create_box
    kind = mesh.CellType.quadrilateral if dim == 2 else mesh.CellType.hexahedron
    domain = create(comm, [np.zeros(dim), np.ones(dim)], [CELLS] * dim, kind)
    V, up = vector_space(domain, degree, COMPONENTS.get(kinematics, 3)), dim - 1
    u = fem.Function(V)
    if kinematics.startswith("axisymmetric"):
        planes = (0,)

    def outer(x):
        """Facets of the walls: not at the bottom, nor in planes of symmetry or on the axis."""
        on = [np.isclose(x[i], 1) for i in range(up)]
        on += [np.isclose(x[i], 0) for i in range(up) if i not in planes]
        return np.any(on, axis=0)

    lid = 1.0 if part is None else 1 - 1 / CELLS - 1e-9
    walls = [
        lambda x: outer(x) & (x[up] < lid + 1e-6),
        lambda x: (outer(x) & (x[up] > lid)) | np.isclose(x[up], 1),
    ]
    ds = tagged_measure("ds", domain, walls)
    dx = tagged_measure("dx", domain, [lambda x: x[up] < lid + 1e-6, lambda x: x[up] > lid])

    def prescribe(axis, place, value, component=None):
        def there(x):  # the lid's own nodes follow its keys
            return np.isclose(x[axis], place) & (place == 1 or x[up] < lid + 1e-6)

        facets = mesh.locate_entities_boundary(domain, dim - 1, there)
        space = V if component is None else V.sub(component)
        dofs = fem.locate_dofs_topological(space, dim - 1, facets)
        return fem.dirichletbc(value, dofs, space)

    bcs = [prescribe(i, 0.0, 0.0, i) for i in planes if dim == 3 or kinematics == "plane_strain"]
    bcs.append(prescribe(up, 0.0, np.zeros(COMPONENTS.get(kinematics, 3))))
    if len(top):
        bcs.append(prescribe(up, 1.0, np.array(top)))
    material = fem_snh.material("stable_neo_hookean", E=E, nu=0.3)
    terms = [fem_snh.Cavity(ds(surface), volume=0.05)]
    terms += [fem_snh.Rigid(group=dx(2), name="lid", **part)] if part is not None else []
    keys = {"bcs": bcs, "terms": terms, "petsc_options": TIGHT}
    keys |= {"kinematics": kinematics} if dim == 2 else {}
    return fem_snh.NonlinearProblem(u, {material: ufl.dx}, **keys)


def box(comm, kinematics, degree, surface, planes=(), **part):
    """Return the solved problem of a box with a rigid lid, and the states of fluid and lid."""
    problem = unsolved_box(comm, kinematics, degree, surface, planes, part)
    problem.solve()
    assert problem.row["converged"]
    (state,) = problem.row["cavities"].values()
    return problem, state, problem.row["rigid"]["lid"]


TURN = {"translate": (0.02, 0.03, -0.05), "rotate": {"axis": (1, 0, 0.2), "angle": 0.2}}
CASES = {
    "turned": ("solid", 1, (), TURN),
    "free": ("solid", 2, (), {"force": (0.02, 0.0, 0.01)}),
    "quarter": ("solid", 1, (0, 1), {"free": ("z",)}),
    "plane": ("plane_strain", 2, (), {"force": (0.02, 0.0, 0.0)}),
    "revolved": ("axisymmetric", 2, (), {}),
    "twisted": ("axisymmetric_torsion", 1, (), {"torque": (0.0, 0.02, 0.0)}),
}


@pytest.mark.mpi
@pytest.mark.parametrize("name", CASES)
def test_a_lid_counts_as_its_facets(comm, name):
    """Volume, pressure, force and moment are those of the surface that has the lid's facets.

    Forces across planes of symmetry depend on where the lid meets them.
    """
    kinematics, degree, planes, part = CASES[name]
    _, fluid, lid = box(comm, kinematics, degree, WALLS, planes=planes, **part)
    _, given, known = box(comm, kinematics, degree, WHOLE, planes=planes, **part)
    assert given["pressure"] > 0.01 * E
    for key in ("volume", "pressure"):
        assert fluid[key] == pytest.approx(given[key], rel=1e-7), key
    keys = ("displacement", "rotation") + (() if planes else ("force", "moment"))
    for key in keys:
        assert lid[key] == pytest.approx(known[key], abs=1e-7), key
    assert lid["force"][2] == pytest.approx(known["force"][2], abs=1e-7)


@pytest.mark.mpi
@pytest.mark.parametrize("planes", [(), (0,), (0, 1)])
def test_the_volume_of_walls_whose_edge_moves(comm, planes):
    """By the determinant of a uniform deformation, in planes of symmetry and by moved edges."""
    top = np.array([0.2 * (0 not in planes), 0.1 * (1 not in planes), 0.3])
    problem = unsolved_box(comm, "solid", 2, WALLS, planes, top=top)._problem
    u = problem.x.duplicate()
    u.array[:] = np.outer(problem.coordinates[:, 2], top).ravel()
    update_ghosts(u)
    (fluid,) = (term for term in problem.terms if term.name == "cavity")
    assert fluid.state(u)["volume"] == pytest.approx(-0.3, rel=1e-12)  # it is outside
    assert fluid.volume_at_rest == pytest.approx(-1.0, rel=1e-12)


@pytest.mark.mpi
def test_derivatives_along_the_motion_of_the_lid(comm):
    """The forces and the Hessian, with its matrix of rank one, where the lid is turned."""
    check_derivatives(box(comm, "solid", 1, WALLS, force=(0.02, 0.0, 0.01))[0]._problem)


BELLOWS = """
mesh = "tube.msh"
element = "Q2"
kinematics = "{kinematics}"
reactions = ["bottom"]
material = {{ name = "stable_neo_hookean", E = 1.0, nu = 0.3 }}
hold = [{{ group = "bottom" }}]
rigid = [{{ group = "top", name = "lid", force = [0, 0.1, 0] }}]
cavity = [{{ group = "inner", volume = 1.0 }}]
"""


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["axisymmetric", "axisymmetric_torsion"])
def test_the_support_has_force_and_pressure_of_the_lid(comm, folder, kinematics):
    """Of a bellows that ends on equal radii: F + p A, the wall's own axial forces cancel."""
    if comm.rank == 0:
        with section(folder / "tube.msh", 2) as (geo, curves, surfaces):
            (bottom, _, top, inner), surface = rectangle(geo, (1, 0), (1.5, 1), (3, 3), False)
            curves |= {"bottom": [bottom], "top": [top], "inner": [inner]}
            surfaces["body"] = [surface]
        (folder / "bellows.toml").write_text(BELLOWS.format(kinematics=kinematics))
    comm.barrier()
    row = solve(folder / "bellows.toml", comm, petsc=TIGHT).steps[-1]
    pressure = row["cavities"]["inner"]["pressure"]
    assert pressure > 0.01
    assert row["reactions"]["bottom"][1] == pytest.approx(-0.1 - pressure * np.pi, rel=1e-6)
