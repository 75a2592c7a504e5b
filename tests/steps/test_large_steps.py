"""Steps that are too large end early; their halves have the solution of smaller steps."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from running import solve

from fem_snh.solver.globalization import NewtonProgress

#: Most Newton and L-BFGS iterations that may be lost: a half takes 9 to 15.
FEW = 20


@pytest.mark.mpi
@pytest.mark.parametrize(("scene", "element", "cells"), [
    ("twist", "Q1", 10), ("twist", "Q2Q1", 4), ("stretch", "Q1", 10),
])  # fmt: skip
def test_a_step_that_is_too_large_is_given_up_early(comm, scene, element, cells):
    """Half a turn in one step led to inverted points, after 2,300 L-BFGS iterations."""
    keys = {"element": element, "cells": cells, "predictor": "none"}
    one, two = (solve(scene, comm, steps=n, **keys) for n in (1, 2))
    first, *halves = one.steps
    assert first["reason"].startswith("INVERTED: min J = -")
    assert first["newton"] <= FEW and first["lbfgs"] <= FEW
    assert [row["load"] for row in halves] == [0.5, 1.0]
    assert halves[-1]["energy"] == pytest.approx(two.steps[-1]["energy"], rel=1e-7)


def test_the_papers_recipe_is_not_given_up(comm):
    """With the clamp in every step, slow steps are usual: cells unfold in the step itself."""
    keys = {"element": "Q1", "cells": 6, "steps": 1, "globalization": "linesearch"}
    (step,) = solve("twist", comm, hessian="clamp", **keys).steps
    assert step["converged"] and step["newton"] > FEW and step["min_J"] > 0.9


@pytest.mark.parametrize(("filter", "energies", "norms", "little"), [
    ("clamp", (10, 2, 1.9), (1, 0.9, 0.8), True),     # 1 % of the decrease, 0.8 of the residual
    ("exact", (10, 2, 1.9), (1, 0.9, 0.8), False),
    ("clamp", (10, 2, 1), (1, 0.9, 0.8), False),      # 11 % of the decrease
    ("clamp", (10, 2, 1.9), (1, 0.9, 0.5), False),    # half of the residual
    ("clamp", (10, 2, 2.1), (1, 0.9, 0.8), False),    # of a saddle point: the energy rises
    ("clamp", (0, 0, 0), (1, 0.9, 0.8), False),       # without an energy
])  # fmt: skip
def test_little_progress(filter, energies, norms, little):
    progress = NewtonProgress()
    for k in (0, 1):
        residual = SimpleNamespace(norm=lambda k=k: norms[k + 1])
        end = SimpleNamespace(energy=energies[k + 1], residual=residual)
        progress.update(norms[k], energies[k], SimpleNamespace(end=end, filter=filter))
    assert progress.is_little == little
