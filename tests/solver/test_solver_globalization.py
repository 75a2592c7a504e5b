"""The choice of Hessian and globalization: defaults, thresholds."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import Hold, create_problem, cube
from solver_problems import half_turn, options, solve, twist

from fem_snh import solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.choices import HESSIANS
from fem_snh.kernels.material import material

mpi = pytest.mark.mpi


def choices(snes):
    """The Hessian and the globalization of a solver."""
    used = snes.getPythonContext().options
    return {key: used[f"snes_{key}"] for key in ("hessian", "globalization")}


@pytest.mark.one_debian
@pytest.mark.parametrize(
    "element, name, expected",
    [
        ("Q1", "stable_neo_hookean", "trust_region"),
        ("Q2Q1", "stable_neo_hookean", "linesearch"),
        ("Q1", "filtered_neo_hookean", "linesearch"),
    ],
)
def test_default_globalization_depends_on_the_problem(comm, element, name, expected):
    chosen = material(name, nu=0.4)
    p = create_problem(cube(comm, "hexahedron", 2), ELEMENTS[element], chosen, hold=[Hold("left")])
    assert solver.default_globalization(p) == expected
    assert choices(solver.create(p)) == {"hessian": "adaptive", "globalization": expected}


def test_a_named_hessian_is_used_with_a_line_search(comm):
    p = twist(comm, cells=1)
    for hessian in HESSIANS:
        expected = {"hessian": hessian, "globalization": "linesearch"}
        assert choices(solver.create(p, hessian)) == expected
        with options(snes_hessian=hessian):
            assert choices(solver.create(p)) == expected


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("hessian", HESSIANS)
def test_trust_region_with_every_hessian(comm, hessian):
    """The twist by half a turn in one step: all of them enter the region, and converge."""
    p = half_turn(comm, 6)
    with options(snes_forcing_max=5e-3, snes_max_it=60):
        snes, context = solve(p, hessian=hessian, globalization="trust_region")
    history = context.history
    assert snes.getConvergedReason() > 0
    assert any(i.filter == "trust_region" for i in history)
    energies = [i.energy for i in history] + [p.energy(p.x)]
    assert (np.diff(energies) <= 1e-12).all()
    # The exact Hessian is indefinite at the start: adaptive falls back to clamp, and exact enters
    # the region, whose first step has no radius yet.
    first = {"exact": "clamp", "clamp": "clamp", "abs": "abs", "adaptive": "clamp"}
    assert history[0].filter == first[hessian]


@pytest.mark.one_debian("ranks")
@mpi
def test_trust_region_is_entered_where_exact_gives_no_descent_direction(comm):
    ends = {}
    for globalization in ("linesearch", "trust_region"):
        snes, context = solve(twist(comm, angle=1.2), "none", "exact", globalization)
        ends[globalization] = solver.converged_reason(snes)
    assert ends == {"linesearch": "DIVERGED_LINEAR_SOLVE", "trust_region": "CONVERGED_FNORM_ABS"}
    assert all(i.step > 0 and i.linear > 0 for i in context.history)
