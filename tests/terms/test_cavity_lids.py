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
from rigid_bodies import check_derivatives

import fem_snh

TIGHT = {"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-10}
E, CELLS = 1.0, 4
#: A box whose upper quarter is rigid; a surface "whole" has its facets, "walls" ends at them.
WHOLE, WALLS = (1, 2), 1


def unsolved_box(
    comm,
    kinematics,
    degree,
    surface,
    planes=(),
    sides=(),
    slabs=(),
    parts=None,
    gap=False,
    top=(),
    fluid=lambda ds: fem_snh.Cavity(ds, volume=0.05),
):
    """Return the problem of a box on a fixed bottom that a fluid around it compresses.

    ``parts`` makes terms of the measure of its upper quarter, whose number is 2; with a ``gap`` it
    is two parts, 2 and 3. Planes of symmetry are the sides at 0 along axes ``planes``, and the
    sides at 0 and 1 along ``slabs``; both ``sides`` along others have no normal displacement.
    ``top`` is the displacement of the upper end, and ``fluid`` the term of the surface.
    """
    dim = 2 if kinematics in COMPONENTS else 3
    create = mesh.create_rectangle if dim == 2 else mesh.create_box
    kind = mesh.CellType.quadrilateral if dim == 2 else mesh.CellType.hexahedron
    domain = create(comm, [np.zeros(dim), np.ones(dim)], [CELLS] * dim, kind)
    V, up = vector_space(domain, degree, COMPONENTS.get(kinematics, 3)), dim - 1
    u = fem.Function(V)

    def outer(x):
        """Facets of the walls: not at the bottom, nor in planes of symmetry or on the axis."""
        on = [np.isclose(x[i], 1) for i in range(up) if i not in slabs]
        on += [np.isclose(x[i], 0) for i in range(up) if i not in (*planes, *slabs)]
        return np.any(on, axis=0)

    if kinematics.startswith("axisymmetric"):
        planes = (0,)
    lid = 1 - 1 / CELLS - 1e-9 if parts else 1.0
    ds = tagged_measure(
        "ds",
        domain,
        [
            lambda x: outer(x) & (x[up] < lid + 1e-6),
            lambda x: (outer(x) & (x[up] > lid)) | np.isclose(x[up], 1),
        ],
    )
    regions = [lambda x: x[up] < lid + 1e-6, lambda x: x[up] > lid]
    if gap:
        halves = (lambda x: x[0] < 0.26, lambda x: x[0] > 0.49)
        regions[1:] = [lambda x, half=half: (x[up] > lid) & half(x) for half in halves]
    dx = tagged_measure("dx", domain, regions)

    def held(axis, place, component=None):
        def there(x):  # the lid's own nodes follow its keys
            return np.isclose(x[axis], place) & (x[up] < lid + 1e-6)

        facets = mesh.locate_entities_boundary(domain, dim - 1, there)
        if component is None:
            zero = np.zeros(COMPONENTS.get(kinematics, 3))
            return fem.dirichletbc(zero, fem.locate_dofs_topological(V, dim - 1, facets), V)
        dofs = fem.locate_dofs_topological(V.sub(component), dim - 1, facets)
        return fem.dirichletbc(0.0, dofs, V.sub(component))

    bcs = [held(i, 0.0, i) for i in planes if dim == 3 or kinematics == "plane_strain"]
    bcs += [held(i, place, i) for i in (*sides, *slabs) for place in (0.0, 1.0)]
    material = fem_snh.material("stable_neo_hookean", E=E, nu=0.3)
    fluid = fluid(ds(surface))
    keys = {"petsc_options": TIGHT}
    if dim == 2:
        keys["kinematics"] = kinematics
    bcs.append(held(up, 0.0))
    if len(top):
        facets = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[up], 1))
        dofs = fem.locate_dofs_topological(V, dim - 1, facets)
        bcs.append(fem.dirichletbc(np.array(top, float), dofs, V))
    terms = [fluid, *(parts(dx) if parts else ())]
    return fem_snh.NonlinearProblem(u, {material: ufl.dx}, bcs=bcs, terms=terms, **keys)


def box(*args, planes=(), sides=(), **part):
    """Return the solved problem of a box with a rigid lid, and the states of fluid and lid."""

    def parts(dx):
        return [fem_snh.Rigid(group=dx(2), name="lid", **part)]

    problem = unsolved_box(*args, planes, sides, parts=parts)
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
def test_derivatives_along_the_motion_of_the_lid(comm):
    """The forces and the Hessian, with its matrix of rank one, where the lid is turned."""
    check_derivatives(box(comm, "solid", 1, WALLS, force=(0.02, 0.0, 0.01))[0]._problem)


BELLOWS = """
mesh = "tube.msh"
element = "Q2"
kinematics = "{kinematics}"
reactions = ["bottom"]
[material]
name = "stable_neo_hookean"
E = 1.0
nu = 0.3
[[hold]]
group = "bottom"
[[rigid]]
group = "top"
name = "lid"
force = [0, 0.1, 0]
[[cavity]]
group = "inner"
volume = 1.0
"""


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["axisymmetric", "axisymmetric_torsion"])
def test_the_support_has_force_and_pressure_of_the_lid(comm, folder, kinematics):
    """Of a bellows that ends on equal radii: F + p A, the wall's own axial forces cancel."""
    if comm.rank == 0:
        with section(folder / "tube.msh", 2) as (geo, curves, surfaces):
            for number, (x, y) in enumerate([(1, 0), (1.5, 0), (1.5, 1), (1, 1)], 1):
                geo.addPoint(x, y, 0, 1.0, number)
            for number in range(1, 5):
                geo.addLine(number, number % 4 + 1, number)
                geo.mesh.setTransfiniteCurve(number, 4)
            surface = geo.addPlaneSurface([geo.addCurveLoop([1, 2, 3, 4])])
            geo.mesh.setTransfiniteSurface(surface)
            geo.mesh.setRecombine(2, surface)
            curves |= {"bottom": [1], "top": [3], "inner": [4]}
            surfaces["body"] = [surface]
        (folder / "bellows.toml").write_text(BELLOWS.format(kinematics=kinematics))
    comm.barrier()
    row = solve(folder / "bellows.toml", comm, petsc=TIGHT).steps[-1]
    pressure = row["cavities"]["inner"]["pressure"]
    assert pressure > 0.01
    assert row["reactions"]["bottom"][1] == pytest.approx(-0.1 - pressure * np.pi, rel=1e-6)
