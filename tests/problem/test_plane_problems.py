"""Meshes of two dimensions in a dolfinx program: plane strain and bodies of revolution."""

from __future__ import annotations

import json

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from bodies import dense
from derivatives import check_derivatives
from dolfinx import fem, mesh
from dolfinx_programs import tagged_measure, vector_space
from paths import DATA
from plane_programs import (
    COMPONENTS,
    ELEMENTS,
    deformation,
    displacement,
    prescribe,
    rectangle,
    sides,
    solve,
    zero,
)

import fem_snh
from benchmarks import felupe_sections
from fem_snh import _dolfinx
from fem_snh.assembly.elements import element as element_of
from fem_snh.assembly.kinematics import PLANAR

#: Nodes and displacements that FElupe computed.
FELUPE = DATA / "felupe_sections.json"
every = pytest.mark.parametrize("kinematics", COMPONENTS)
SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.4)
SIMO = fem_snh.material("neo_hookean_simo", E=1.0, nu=0.5)


def problem(element, kinematics, u, material=SNH, **keywords):
    """The assembled problem itself, not solved."""
    keywords |= {"element": element, "kinematics": kinematics}
    return fem_snh.NonlinearProblem(u, {material: ufl.dx}, **keywords)._problem


def scattered(element, kinematics, low=(0.5, 0.0), cells=(2, 2), size=0.1):
    """A problem on a distorted rectangle, with a random displacement."""
    high = (low[0] + 1, low[1] + 1)
    domain = rectangle(MPI.COMM_SELF, element, low, high, cells)
    rng = np.random.default_rng(0)
    x = domain.geometry.x
    x[:, :2] += rng.uniform(-0.05, 0.05, (len(x), 2)) * (x[:, :1] > low[0])
    u = displacement(domain, element, kinematics)
    made = problem(element, kinematics, u)
    made.x.array[:] = 0.0
    made.x.array[: len(u.x.array)] = rng.uniform(-size, size, len(u.x.array))
    return made


# --- derivatives and eigenvalues --------------------------------------------------------------


@every
@pytest.mark.parametrize("element", ["P1", "Q1", "P2", "Q2"])
def test_energy_residual_and_hessian_are_those_of_ufl(element, kinematics):
    made = scattered(element, kinematics)
    V, u = made.V, fem.Function(made.V)
    u.x.array[:] = made.x.array_r
    F, weight = deformation(u, kinematics)
    kind = element_of(element, kinematics=PLANAR[kinematics])
    dx = _dolfinx.cell_measures(V.mesh, [[0]], kind.cell, kind.quadrature)[0]
    energy = SNH.ufl(F) * weight * dx
    residual = ufl.derivative(energy, u, ufl.TestFunction(V))
    hessian = _dolfinx.form(ufl.derivative(residual, u, ufl.TrialFunction(V)))
    expected = _dolfinx.assemble_scalar(_dolfinx.form(energy))
    assert made.energy(made.x) == pytest.approx(expected, rel=1e-13)
    force, other = made.x.duplicate(), _dolfinx.create_vector(V)
    made.gradient(made.x, force)
    _dolfinx.assemble_vector(other, _dolfinx.form(residual))
    assert abs(force.array - other.array).max() < 1e-13 * abs(other.array).max()
    made.jacobian(made.x, "exact")
    A = _dolfinx.create_matrix(hessian)
    _dolfinx.assemble_matrix(A, hessian)
    assert abs(dense(made.A) - dense(A)).max() < 1e-13 * abs(dense(A)).max()


@pytest.mark.one_debian
@every
@pytest.mark.parametrize("element", ELEMENTS)
def test_residual_and_hessian_are_derivatives(element, kinematics):
    """Central differences of energy and residual, with the elements' own volume terms."""
    made = scattered(element, kinematics)
    check_derivatives(made, range(0, made.x.getLocalSize(), 7), 1e-6, 1e-8, 1e-8)


@every
@pytest.mark.parametrize("element", ELEMENTS)
def test_filtered_hessian_is_positive_semidefinite(element, kinematics):
    """The exact one is not: half of the points are inverted."""
    check_filters(scattered(element, kinematics, size=0.6))


def check_filters(made):
    """Assert that all filtered Hessians have no negative eigenvalue, unlike the exact one."""
    size, smallest = made.owned_displacements, {}
    for filter in ("exact", "clamp", "abs"):
        made.jacobian(made.x, filter)
        values = np.linalg.eigvalsh(dense(made.A)[:size, :size])
        smallest[filter] = values[0] / values[-1]
    assert made.measures(made.x)["min_J"] < 0
    assert smallest["exact"] < -1e-3
    assert smallest["clamp"] > -1e-13 and smallest["abs"] > -1e-13


@every
@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("nu", [0.4, 0.4999])
def test_rest_has_the_rigid_motions_and_no_spurious_modes(element, nu, kinematics):
    """Of one cell, or two triangles; the near null space holds the motions."""
    domain = rectangle(MPI.COMM_SELF, element, (0.5, 0.0), (1.5, 1.0), (1, 1))
    u = displacement(domain, element, kinematics)
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=nu)
    made = problem(element, kinematics, u, material)
    made.x.set(0.0)
    made.jacobian(made.x, "exact")
    values = np.linalg.eigvalsh(dense(made.A))
    zeros = abs(values) <= 1e-12 * values[-1]
    pressures = len(values) - made.owned_displacements
    motions = {"plane_strain": 3, "axisymmetric": 1, "axisymmetric_torsion": 2}[kinematics]
    assert (int((values[~zeros] < 0).sum()), int(zeros.sum())) == (pressures, motions)
    if not pressures:
        near = made.A.getNearNullSpace().getVecs()
        assert len(near) == motions
        for motion in near:
            assert (made.A * motion).norm() < 1e-13 * values[-1]


# --- a layer of hexahedra ---------------------------------------------------------------------


@pytest.mark.parametrize("element", ["Q1", "Q1P0", "Q2"])
def test_plane_strain_is_a_layer_of_hexahedra(element):
    """With the displacement along z constrained, and the same quadrature in the plane."""
    n, degree = 4, int(element[1])
    flat = rectangle(MPI.COMM_SELF, element, (0.0, 0.0), (1.0, 1.0), (n, n))
    corners = [np.zeros(3), np.array([1.0, 1.0, 0.25])]
    layer = mesh.create_box(MPI.COMM_SELF, corners, (n, n, 1), mesh.CellType.hexahedron)
    found = {}
    for domain, components in ((flat, 2), (layer, 3)):
        x = domain.geometry.x
        x[:, 1] += 0.3 * x[:, 0] * (1 - x[:, 1] / 2)  # a membrane like Cook's
        V = vector_space(domain, degree, components)
        u, top = fem.Function(V), fem.Function(V)
        top.x.array[1::components] = 0.4
        dim = domain.topology.dim - 1

        def nodes(space, at, dim=dim, domain=domain):
            facets = mesh.locate_entities_boundary(domain, dim, lambda x: np.isclose(x[0], at))
            return fem.locate_dofs_topological(space, dim, facets)

        bcs = [fem.dirichletbc(np.zeros(components), nodes(V, 0.0), V)]
        bcs.append(fem.dirichletbc(top, nodes(V, 1.0)))
        if components == 3:
            domain.topology.create_connectivity(3, 3)
            cells = np.arange(n * n, dtype=np.int32)
            third = fem.locate_dofs_topological(V.sub(2), 3, cells)
            bcs.append(fem.dirichletbc(0.0, third, V.sub(2)))
        kinematics = "plane_strain" if components == 2 else None
        made = solve(u, SNH, bcs, element=element, kinematics=kinematics)
        found[components] = V.tabulate_dof_coordinates(), u.x.array.reshape(-1, components), made
    X, u, plane = found[2]
    X3, u3, solid = found[3]
    for x, displaced in zip(X3, u3, strict=True):
        nearest = abs(X[:, :2] - x[:2]).sum(axis=1).argmin()
        assert abs(u[nearest] - displaced[:2]).max() < 1e-10 and displaced[2] == 0
    energies = [made._problem.energy(made.x) for made in (plane, solid)]
    assert energies[0] * 0.25 == pytest.approx(energies[1], rel=1e-11)


# --- exact solutions --------------------------------------------------------------------------


def tube_pressure(a, inner=1.0, outer=2.0):
    """The pressure that inflates a tube of SIMO from the inner radius to a.

    dp = mu (l^2 - l^-2) dr/r with the hoop stretch l = r/R (Ogden 1997, section 5.3.3).
    """
    r = np.linspace(a, np.sqrt(outer**2 + a**2 - inner**2), 20001)
    hoop = r / np.sqrt(r**2 - a**2 + inner**2)
    f = SIMO.lame[0] * (hoop**2 - hoop**-2.0) / r
    return float(((f[1:] + f[:-1]) / 2 * np.diff(r)).sum())


def tube(element, cells):
    """A tube inflated by a prescribed displacement: error of the outer radius, and the pressure."""
    inner, outer, a, height = 1.0, 2.0, 1.5, 0.25
    domain = rectangle(MPI.COMM_SELF, element, (inner, 0.0), (outer, height), (cells, 1))
    u = displacement(domain, element, "axisymmetric")
    V = u.function_space
    bcs = [c for z in (0.0, height) for c in prescribe(V, 1, z, zero, [1])]
    bcs += prescribe(V, 0, inner, lambda x: np.array([[a - inner], [0.0]]), [0])
    made = solve(u, SIMO, bcs, element=element, kinematics="axisymmetric")
    x, values = V.tabulate_dof_coordinates(), u.x.array.reshape(-1, 2)
    exact = np.sqrt(x[:, 0] ** 2 + a**2 - inner**2)
    force = made.x.duplicate()
    made._problem.gradient(made.x, force)
    radial = force.array[2 * sides(V, 0, inner)].sum()
    pressure = radial / (2 * np.pi * a * height)
    return abs(x[:, 0] + values[:, 0] - exact).max(), abs(pressure / tube_pressure(a) - 1)


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["Q2Q1", "P2P1"])
def test_incompressible_tube_under_pressure(element):
    coarse, fine = tube(element, 8), tube(element, 16)
    assert fine[0] < 1e-5 and fine[1] < 1e-5
    assert coarse[0] > 6 * fine[0]


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["axisymmetric", "axisymmetric_torsion"])
def test_follower_pressure_inflates_a_tube(comm, kinematics):
    """The pressure of the exact solution gives its radius; with an energy, as its ends are held."""
    inner, outer, a, height = 1.0, 2.0, 1.2, 0.25
    domain = rectangle(comm, "Q2Q1", (inner, 0.0), (outer, height), (12, 1))
    u = displacement(domain, "Q2Q1", kinematics)
    V = u.function_space
    held = [1] if kinematics == "axisymmetric" else [1, 2]
    bcs = [c for z in (0.0, height) for c in prescribe(V, 1, z, zero, held)]
    side = tagged_measure("ds", domain, [lambda x: np.isclose(x[0], inner)])(1)
    term = fem_snh.Pressure(group=side, value=tube_pressure(a))
    made = fem_snh.NonlinearProblem(
        u, {SIMO: ufl.dx}, bcs=bcs, terms=[term], element="Q2Q1", kinematics=kinematics
    )
    *_, last = made.steps(4)
    assert last["converged"] and made._problem.has_energy
    values = u.x.array.reshape(-1, COMPONENTS[kinematics])[:, 0]
    radii = V.tabulate_dof_coordinates()[:, 0]
    exact = np.sqrt(radii**2 + a**2 - inner**2) - radii
    assert abs(values - exact).max(initial=0) < 1e-4


@pytest.mark.one_debian
@pytest.mark.parametrize("kinematics", COMPONENTS)
def test_energy_of_a_follower_pressure(kinematics):
    """A free end costs it its energy; on a body of revolution an end on the axis does not."""
    found = []
    for low in (0.0, 0.5):
        domain = rectangle(MPI.COMM_SELF, "Q1", (low, 0.0), (low + 1, 1.0), (2, 2))
        u = displacement(domain, "Q1", kinematics)
        bcs = prescribe(u.function_space, 1, 0.0, zero)
        free = [lambda x: np.isclose(x[1], 1), lambda x, low=low: np.isclose(x[0], low + 1)]
        term = fem_snh.Pressure(group=tagged_measure("ds", domain, free)((1, 2)), value=1.0)
        found.append(problem("Q1", kinematics, u, bcs=bcs, terms=[term]).has_energy)
    assert found == [kinematics != "plane_strain", False]


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["Q2Q1", "P2P1"])
def test_torsion_of_a_cylinder(element):
    """Rivlin's solution: torque mu pi a^4 t/2 and axial force -mu pi a^4 t^2/4 at a twist t."""
    twist, height = 0.8, 0.5
    material = fem_snh.material("neo_hookean_simo", E=3.0, nu=0.5)
    domain = rectangle(MPI.COMM_SELF, element, (0.0, 0.0), (1.0, height), (4, 4))
    u = displacement(domain, element, "axisymmetric_torsion")
    V = u.function_space

    def turned(x):
        angle = twist * x[1]
        return np.array([x[0] * (np.cos(angle) - 1), 0 * x[0], x[0] * np.sin(angle)])

    bcs = [c for z in (0.0, height) for c in prescribe(V, 1, z, turned)]
    made = solve(u, material, bcs, element=element, kinematics="axisymmetric_torsion")
    x, values = V.tabulate_dof_coordinates(), u.x.array.reshape(-1, 3)
    assert abs(values.T - turned(x.T)).max() < 2e-4
    # The third component is along z, so that the turn is about -y.
    bottom, top = (made.reaction_moment(c) for c in bcs)
    assert top == pytest.approx([0, -np.pi / 2 * twist, 0], rel=1e-4)
    assert bottom == pytest.approx(-top, rel=1e-6)
    axial = made.reaction_force(bcs[1])[1]
    assert axial == pytest.approx(-np.pi / 4 * twist**2, rel=2e-3)
    about = (0.3, 7.0, -0.2)  # the forces of the turn add up to one along the axis
    shifted = top - np.cross(about, [0, axial, 0])
    assert made.reaction_moment(bcs[1], about) == pytest.approx(shifted, rel=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("element", ["Q2Q1", "P2P1"])
def test_pure_bending_of_a_block(comm, element):
    """Rivlin's flexure: the ends exert no force, but a moment that is the integral of r s_tt."""
    h, length, turn = 0.5, 0.8, 1.2
    alpha = length / turn
    # r^2 = 2 alpha X + beta with free surfaces, where r_1 r_2 = alpha^2.
    beta = alpha * np.sqrt(alpha**2 + h**2)
    r1, r2 = (np.sqrt(beta + s * alpha * h) for s in (-1, 1))
    assert r1 * r2 == pytest.approx(alpha**2)

    def bent(x):
        r, t = np.sqrt(2 * alpha * x[0] + beta), x[1] / alpha
        return np.array([r * np.cos(t) - x[0], r * np.sin(t) - x[1]])

    def hoop(r):  # with mu = 1
        radial = r**2 / (2 * alpha**2) + alpha**2 / (2 * r**2)
        radial -= r1**2 / (2 * alpha**2) + alpha**2 / (2 * r1**2)
        return radial + r**2 / alpha**2 - alpha**2 / r**2

    radii, weights = np.polynomial.legendre.leggauss(30)
    radii, weights = (r1 + r2) / 2 + (r2 - r1) / 2 * radii, (r2 - r1) / 2 * weights
    assert weights @ hoop(radii) == pytest.approx(0, abs=1e-13)
    moment = weights @ (radii * hoop(radii))
    domain = rectangle(comm, element, (-h / 2, 0.0), (h / 2, length), (4, 6))
    u = displacement(domain, element, "plane_strain")
    V = u.function_space
    bcs = [c for y in (0.0, length) for c in prescribe(V, 1, y, bent)]
    u.interpolate(bent)
    material = fem_snh.material("neo_hookean_simo", E=3.0, nu=0.5)
    made = solve(u, material, bcs, element=element, kinematics="plane_strain")
    for bc, sign in zip(bcs, (-1, 1), strict=True):
        assert made.reaction_force(bc) == pytest.approx([0, 0, 0], abs=2e-3 * moment / h)
        for about in ([0, 0, 0], [0.7, -0.3, 2.0]):
            found = made.reaction_moment(bc, about)
            assert found[2] == pytest.approx(sign * moment, rel=2e-3)
    one, other = (made.reaction_moment(bc, [0.7, -0.3, 0]) for bc in bcs)
    assert one == pytest.approx(-other, rel=1e-6)


# --- another program --------------------------------------------------------------------------


@pytest.mark.one_debian
@pytest.mark.parametrize("case", json.loads(FELUPE.read_text()))
def test_displacements_are_those_of_felupe(case):
    """On the same distorted mesh; ``python -m benchmarks felupe_sections --cells 3 --out FILE``."""
    element, kinematics, cells = case.split()
    stored = json.loads(FELUPE.read_text())[case]
    points, expected = np.array(stored["points"]), np.array(stored["displacements"])
    found = felupe_sections.displacements(element, kinematics, int(cells), points)
    assert len(points) == (3 * int(element[1]) + 1) ** 2
    assert abs(found - expected).max() < 1e-10
