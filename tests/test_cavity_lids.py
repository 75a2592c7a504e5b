"""Cavities that rigid parts close: the lid's area counts as that of facets."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import vector_space
from gmsh_files import section
from plane_programs import COMPONENTS
from test_plane_scenes import solve

import fem_snh
from fem_snh.errors import BadInput

TIGHT = {"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-10}
E, CELLS = 1.0, 4
#: A box whose upper quarter is rigid; a surface "whole" has its facets, "walls" ends at them.
WHOLE, WALLS = (1, 2), 1


def box(comm, kinematics, degree, surface, planes=(), sides=(), **part):
    """Return a box on a fixed bottom that a fluid around it compresses, with a rigid lid."""
    dim = 2 if kinematics in COMPONENTS else 3
    create = mesh.create_rectangle if dim == 2 else mesh.create_box
    kind = mesh.CellType.quadrilateral if dim == 2 else mesh.CellType.hexahedron
    domain = create(comm, [np.zeros(dim), np.ones(dim)], [CELLS] * dim, kind)
    V, up = vector_space(domain, degree, COMPONENTS.get(kinematics, 3)), dim - 1
    u = fem.Function(V)

    def tagged(measure, of, places):
        found = [mesh.locate_entities(domain, of, place) for place in places]
        if of < dim:
            outside = mesh.locate_entities_boundary(domain, of, lambda x: x[0] == x[0])
            found = [np.intersect1d(entities, outside) for entities in found]
        tags = {int(i): tag for tag, some in enumerate(found, 1) for i in some}
        items = np.array(sorted(tags), np.int32)
        values = np.array([tags[i] for i in items], np.int32)
        data = mesh.meshtags(domain, of, items, values)
        return ufl.Measure(measure, domain=domain, subdomain_data=data)

    def outer(x):
        """Facets of the walls: not at the bottom, nor in planes of symmetry or on the axis."""
        on = [np.isclose(x[i], 1) for i in range(up)]
        on += [np.isclose(x[i], 0) for i in range(up) if i not in planes]
        return np.any(on, axis=0)

    if kinematics.startswith("axisymmetric"):
        planes = (0,)
    lid = 1 - 1 / CELLS - 1e-9
    ds = tagged(
        "ds",
        dim - 1,
        [
            lambda x: outer(x) & (x[up] < lid + 1e-6),
            lambda x: (outer(x) & (x[up] > lid)) | np.isclose(x[up], 1),
        ],
    )
    dx = tagged("dx", dim, [lambda x: x[up] < lid + 1e-6, lambda x: x[up] > lid])

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
    bcs += [held(i, place, i) for i in sides for place in (0.0, 1.0)]
    material = fem_snh.material("stable_neo_hookean", E=E, nu=0.3)
    fluid = fem_snh.Cavity(ds(surface), volume=0.05)
    keys = {"petsc_options": TIGHT}
    if dim == 2:
        keys["kinematics"] = kinematics
    terms = [fluid, fem_snh.Rigid(group=dx(2), name="lid", **part)]
    problem = fem_snh.NonlinearProblem(
        u, {material: ufl.dx}, bcs=[*bcs, held(up, 0.0)], terms=terms, **keys
    )
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
    """Volume, pressure, force and moment are those of the surface that has the lid's facets."""
    kinematics, degree, planes, part = CASES[name]
    _, fluid, lid = box(comm, kinematics, degree, WALLS, planes, **part)
    _, given, known = box(comm, kinematics, degree, WHOLE, planes, **part)
    assert given["pressure"] > 0.01 * E
    for key in ("volume", "pressure"):
        assert fluid[key] == pytest.approx(given[key], rel=1e-7), key
    for key in ("displacement", "rotation", "force", "moment"):
        assert lid[key] == pytest.approx(known[key], abs=1e-7), key


@pytest.mark.mpi
def test_the_volume_is_area_times_motion(comm):
    """A d, of a piston between smooth walls."""
    _, fluid, _ = box(comm, "solid", 1, WALLS, sides=(0, 1), translate=(0, 0, -0.1))
    assert fluid["volume"] == pytest.approx(0.1, rel=1e-12)


@pytest.mark.mpi
def test_derivatives_along_the_motion_of_the_lid(comm):
    """The forces and the Hessian, with its matrix of rank one, where the lid is turned."""
    problem = box(comm, "solid", 1, WALLS, force=(0.02, 0.0, 0.01))[0]._problem
    x, end = problem.x, problem.x.duplicate()

    def step(wave, size):
        d = x.duplicate()
        d.array[: problem.owned_displacements] = np.sin(wave * problem.coordinates + wave).ravel()
        d.array[problem.constrained_dofs] = 0.0
        d.scale(size)
        return d

    problem.retraction(x, step(9.0, 0.05), 1.0, end)
    end.copy(x)
    d, f, Hd = step(5.0, 0.1), x.duplicate(), x.duplicate()

    def energy(s):
        problem.retraction(x, d, s, end)
        return problem.energy(end)

    problem.residual(x, f)
    h = 1e-3
    slope = (8 * (energy(h) - energy(-h)) - energy(2 * h) + energy(-2 * h)) / (12 * h)
    assert f.dot(d) == pytest.approx(slope, rel=1e-7)
    problem.jacobian(x, "exact")
    problem.operator.mult(d, Hd)
    h = 1e-2
    inner, outer = energy(h) + energy(-h), energy(2 * h) + energy(-2 * h)
    curvature = (16 * inner - 30 * energy(0.0) - outer) / (12 * h**2)
    assert d.dot(Hd) == pytest.approx(curvature, rel=1e-6)


@pytest.mark.mpi
def test_a_lid_that_nothing_closes_is_refused(comm):
    """In half a plane the wall, from the fixed bottom to the lid, does not touch the symmetry."""
    with pytest.raises(BadInput, match="on rigid parts or in planes of symmetry"):
        box(comm, "plane_strain", 1, WALLS, (0,), free=("y",))


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
