"""The program's choice between the iterative and the direct linear solver."""

from __future__ import annotations

import re

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from plane_programs import displacement, prescribe, rectangle, sides, zero

import fem_snh
from benchmarks.contrast import SHAPES, inclusion
from fem_snh.errors import BadInput


@pytest.mark.one_debian
@pytest.mark.parametrize(
    ("values", "solver", "reason"),
    [
        ({"nu": 0.4999, "element": "Q1"}, "preonly+cholesky",
         r"s\^3/N\^1\.5 sqrt\(1 - 2 nu\) = 0\.041 <= 0\.15: fac"),
        ({"nu": 0.49, "element": "Q1"}, "cg+ssor", r"= 0\.41 > 0\.15: iterations cost less"),
        ({"nu": 0.4999, "scene": "twist", "angle": 0.1}, "cg+ssor", r"= 0\.39 > 0\.15: iter"),
        (
            {"nu": 0.3, "scene": "stretch", "aspect": 9.0, "cells": 3, "stretch": 1.1},
            "preonly+cholesky",
            "< 1.5: a bar, which may buckle",
        ),
        ({"nu": 0.499, "element": "Q1P0"}, "fgmres+block_triangular", "an unknown pressure: few"),
        ({"nu": 0.5, "element": "Q2Q1"}, "fgmres+block_triangular", "an unknown pressure: few"),
    ],
)  # fmt: skip
def test_a_layer_of_nearly_incompressible_cells_is_solved_directly(values, solver, reason):
    given = {"cells": 8, "steps": 1, "comm": MPI.COMM_SELF, "progress": False} | values
    given |= {} if "scene" in given else {"scene": "cook", "kinematics": "layer", "force": 10.0}
    record = fem_snh.run(given.pop("scene"), **given).record
    chosen = record["defaults"]["linear_solver"]
    assert record["converged"] and chosen["value"] == record["linear_solver"] == solver
    assert re.search(reason, chosen["reason"])


@pytest.mark.one_debian
def test_a_short_strip_buckles():
    """Just beyond the critical load of a perfect strip iterations may stay at the straight one."""
    domain = rectangle(MPI.COMM_SELF, "Q1", (0, 0), (1, 3.5), (20, 70))
    u = displacement(domain, "Q1", "plane_strain")
    V = u.function_space
    lid = fem.Function(V)
    top = [fem.dirichletbc(lid, sides(V, 1, 3.5))]
    snh = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    problem = fem_snh.NonlinearProblem(
        u, {snh: ufl.dx}, bcs=prescribe(V, 1, 0.0, zero) + top, kinematics="plane_strain"
    )
    for squeeze in np.linspace(0.025, 0.2, 8):
        lid.x.array[1::2] = -3.5 * squeeze
        problem.solve()
        assert problem.reason.startswith("CONVERGED")
    middle = np.isclose(V.tabulate_dof_coordinates()[:, 0], 0.5)
    assert abs(u.x.array.reshape(-1, 2)[middle, 0]).max() > 0.1
    assert problem.solver.computeObjective(problem.x) < 0.08355  # straight: 0.083558


def test_the_user_chooses_the_linear_solver():
    given = {"kinematics": "layer", "cells": 4, "steps": 1, "nu": 0.4999}
    given |= {"comm": MPI.COMM_SELF, "progress": False}
    for name, solver in (("iterative", "cg+ssor"), ("direct", "preonly+cholesky")):
        record = fem_snh.run("cook", petsc={"snes_linear_solver": name}, **given).record
        assert record["linear_solver"] == solver and "linear_solver" not in record["defaults"]
    with pytest.raises(BadInput, match="snes_linear_solver = 'exact': expected one of automatic"):
        fem_snh.run("cook", petsc={"snes_linear_solver": "exact"}, **given)


@pytest.mark.one_debian
@pytest.mark.filterwarnings("ignore::fem_snh.errors.ResultNote")
@pytest.mark.parametrize("shape", ["bar", "sphere"])
def test_a_stiff_inclusion_that_turns_has_factors(shape, contrast=1e4):
    """At most three times the Newton iterations of the homogeneous cube, and the same energy."""
    cube = inclusion(MPI.COMM_SELF, SHAPES[shape], 1.0, 6, {})
    cube.solve()
    stiff = inclusion(MPI.COMM_SELF, SHAPES[shape], contrast, 6, {})
    choice = stiff.solver.getPythonContext().linear_choice
    assert choice.direct and "contrast of the moduli" in choice.reason
    stiff.solve()
    assert stiff.solver.getConvergedReason() > 0 and stiff.newton <= 3 * cube.newton
    # The stiff part is nearly rigid: its contrast hardly changes the energy.
    energy = stiff.solver.computeObjective(stiff.x)
    rigid = inclusion(MPI.COMM_SELF, SHAPES[shape], 3 * contrast, 6, {})
    rigid.solve()
    assert energy == pytest.approx(rigid.solver.computeObjective(rigid.x), rel=30 / contrast)


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize(
    ("scene", "given", "most"),
    [
        ("cook", {"kinematics": "plane_strain", "element": "Q1", "cells": 32, "nu": 0.3}, 25),
        ("cook", {"kinematics": "plane_stress", "element": "P1", "cells": 16, "nu": 0.3}, 25),
        ("cook", {"kinematics": "plane_strain", "element": "P2", "cells": 8, "nu": 0.3}, 40),
        ("cook", {"kinematics": "plane_strain", "element": "Q2Q1", "cells": 8}, 12),
        ("tube", {"kinematics": "axisymmetric", "element": "Q1", "cells": 16, "nu": 0.4}, 25),
        ("bushing", {"kinematics": "axisymmetric_torsion", "element": "Q1", "nu": 0.4}, 40),
    ],
)
def test_both_solvers_solve_sections(comm, scene, given, most):
    """The same displacements and forces, and few iterations per Newton iteration."""
    results = []
    for solver in ("direct", "iterative"):
        petsc = {"snes_linear_solver": solver, "snes_scaled_tol": 1e-13}
        results.append(fem_snh.run(scene, comm=comm, progress=False, petsc=petsc, **given))
        assert results[-1].converged
    direct, iterative = (result.steps for result in results)
    for one, other in zip(direct, iterative, strict=True):
        assert other["energy"] == pytest.approx(one["energy"], rel=1e-10)
        for key in one.keys() & {"probes", "reactions"}:
            for name, value in one[key].items():
                assert other[key][name] == pytest.approx(value, rel=1e-8, abs=1e-8)
    newton, linear = (sum(step[key] for step in iterative) for key in ("newton", "linear"))
    assert linear <= most * newton
