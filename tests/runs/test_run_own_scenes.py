"""Runs of scenes made in Python and of TOML files; PETSc options of a scene."""

from __future__ import annotations

from petsc4py import PETSc

import pytest
from running import solve

from fem_snh import solver
from fem_snh.choices import GLOBALIZATIONS
from fem_snh.errors import on_root
from fem_snh.mesh import gmsh_input, gmsh_model
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Rotate, Scene

mpi = pytest.mark.mpi


def bar(**keys):
    rollers = (("left", "x"), ("front", "y"), ("bottom", "z"))
    given = {
        "name": "bar", "element": "Q1", "steps": 2,
        "material": MaterialChoice(name="neo_hookean", E=10.0, nu=0.3),
        "hold": [Hold(group=group, components=(axis,)) for group, axis in rollers],
    }  # fmt: skip
    return Scene(**given | keys)


@pytest.mark.one_debian("ranks")
@mpi
def test_a_scene_made_in_python(comm):
    move = Move(group="right", components=("x",), translate=(0.4, 0, 0))
    scene = bar(mesh=Geometry(source="cube"), cells=2, move=[move])
    result = solve(scene, nu=0.0)  # overrides count
    assert result.converged and result.record["material"]["nu"] == 0
    assert result.u.name == "displacement" and result.problem.load == 1
    u = result.u.x.array.reshape(-1, 3)
    X = result.problem.V.tabulate_dof_coordinates()
    assert u[:, 0] == pytest.approx(0.4 * X[:, 0], abs=1e-6)
    # nu = 0: eq. 5 has no volume term, and each stretch is on its own
    assert abs(u[:, 1:]).max() < 1e-6


def own_mesh(path, scale=1.0, cells=2):
    """The unit cube as a user's .msh, with numbered and named groups."""
    with gmsh_model.session() as gmsh:
        gmsh.onelab.setNumber("cells", [float(cells)])
        gmsh.open(str(gmsh_input.source_path("cube")))
        gmsh.model.mesh.generate(3)
        gmsh.option.setNumber("Mesh.ScalingFactor", scale)
        gmsh.option.setNumber("Mesh.Binary", 1)  # text has 16 digits: one too few for a double
        gmsh.write(str(path))


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("globalization", GLOBALIZATIONS)
def test_size_and_stiffness_are_units_to_a_toml_scene(comm, folder, globalization):
    """A body of a millimetre and of steel takes the iterations of a metre of jelly.

    On 4 cells in each direction: on 2, conjugate gradients exhaust the Krylov space, and rounding
    decides when.
    """
    found = []
    # Powers of two scale without rounding.
    length, modulus = 2.0**-10, 2.0**20
    for name, scale, E in (("large", 1.0, 1.0), ("small", length, modulus)):
        on_root(comm, own_mesh, folder / f"{name}.msh", scale, 4)
        turn = Rotate(axis=(0, 0, 1), through=(0.5 * scale,) * 3, angle=1.0)
        scene = bar(
            mesh=folder / f"{name}.msh",
            material=MaterialChoice(name="stable_neo_hookean", E=E, nu=0.49),
            hold=[Hold(group="bottom")],
            move=[Move(group="top", translate=(0, 0, 0.2 * scale), rotate=turn)],
        )
        found.append(solve(scene, globalization=globalization).steps)
    for one, other in zip(*found, strict=True):
        for key in ("newton", "clamped", "reason"):
            assert one[key] == other[key]
        assert other["linear"] == pytest.approx(one["linear"], abs=2)
        assert other["energy"] / (modulus * length**3) == pytest.approx(one["energy"], rel=1e-8)


@pytest.mark.one_debian("ranks")
@mpi
def test_petsc_options_of_a_scene_end_with_it_and_yield_to_the_command_lines(comm):
    database = PETSc.Options(solver.PREFIX)
    petsc = {"ksp_type": "minres", "snes_max_it": 150}
    result = solve("twist", cells=1, angle=0.1, petsc=petsc)
    assert result.record["linear_solver"] == "minres+jacobi"
    assert not database.hasName("ksp_type")
    database["ksp_type"] = "cr"
    try:
        result = solve("twist", cells=1, angle=0.1, petsc=petsc)
        assert result.record["linear_solver"] == "cr+jacobi"
        assert database.getString("ksp_type") == "cr" and not database.hasName("snes_max_it")
    finally:
        database.delValue("ksp_type")
