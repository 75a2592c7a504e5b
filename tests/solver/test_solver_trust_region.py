"""The trust region and the L-BFGS iterations."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import Condition, Hold, dense, problem, set_values
from solver_problems import SYMMETRIC, TRUST, half_turn, options, solve, twist

from fem_snh import solver
from fem_snh.mesh import mesh

mpi = pytest.mark.mpi


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize(("cells", "noise"), [(8, 0.0), (8, 1e-10), (8, 1e-4), (12, 0.0)])
def test_trust_region_leaves_nearly_unstable_states(comm, cells, noise):
    """The twist by half a turn in one step, where filtered steps make little progress."""
    p = half_turn(comm, cells, noise)
    with options(snes_forcing_max=5e-3, snes_max_it=40):
        snes, context = solve(p, **TRUST)
    history = context.history
    assert snes.getConvergedReason() > 0 and len(history) <= 30
    assert any(i.filter == "trust_region" for i in history)
    energies = [i.energy for i in history] + [p.energy(p.x)]
    assert (np.diff(energies) <= 1e-12).all()
    # L-BFGS iterations follow steps in the region only.
    first = next(k for k, i in enumerate(history) if i.lbfgs)
    assert first > 3 and all(i.step > 0 for i in history)
    assert 0 < max(i.lbfgs for i in history) <= 640


@pytest.mark.one_debian
@mpi
def test_lbfgs_iterations_save_newton_iterations(comm):
    counts = []
    for max_it in (0, 5, 20):
        p = half_turn(comm, 6)
        with options(snes_forcing_max=5e-3, snes_lbfgs_max_it=max_it):
            snes, context = solve(p, **TRUST)
        assert snes.getConvergedReason() > 0
        assert all(i.lbfgs <= max_it for i in context.history)
        counts.append(len(context.history))
        if comm.size == 1:
            p.jacobian(p.x, "exact")
            assert np.linalg.eigvalsh(dense(p.A))[0] > 0  # a minimum, not a saddle point
    assert max(counts[:2]) > counts[2] and counts[0] > counts[2]


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("hessian", ["clamp", "adaptive"])
def test_lbfgs_with_a_line_search_reaches_the_same_state(comm, hessian):
    counts, energies = [], []
    for max_it in (0, 20):
        p = twist(comm, angle=1.2)
        with options(snes_lbfgs_max_it=max_it, pc_type="bjacobi", sub_pc_type="icc"):
            snes, context = solve(p, hessian=hessian)
        assert snes.getConvergedReason() > 0
        counts.append(len(context.history))
        energies.append(p.energy(p.x))
    assert counts[1] < counts[0]
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)


@pytest.mark.one_debian("ranks")
@mpi
def test_trust_region_leaves_an_unstable_state_that_clamp_does_not(comm):
    """A straight column compressed far beyond its buckling load."""
    body = mesh.generate(comm, "cylinder", "hexahedron", cells=3, length=6.0, radius=0.5)
    compression = [
        Condition("right", lambda X, load: load * np.array([-1.8, 0, 0]) * np.ones_like(X))
    ]
    p = problem(body, "Q1", hold=[Hold("left")], move=compression)
    with options(snes_scaled_tol=1e-5, **SYMMETRIC):
        snes, _ = solve(p, hessian="clamp", predictor="tangent")
    straight, energy = p.x.copy(), p.energy(p.x)
    bow = set_values(
        p, lambda X: 1e-4 * np.sin(np.pi * X[:, :1] / 6) ** 2 * [0, 1, 0], p.x.duplicate()
    )
    straight.axpy(1.0, bow)
    assert snes.getConvergedReason() > 0  # clamp converges to the saddle point
    ends = {}
    for hessian, globalization in (("clamp", "linesearch"), ("adaptive", "trust_region")):
        straight.copy(p.x)
        with options(snes_max_it=70, snes_linear_solver="iterative"):
            snes = solver.create(p, hessian, globalization)
            snes.solve(None, p.x)
        ends[globalization] = solver.converged_reason(snes)
    assert ends == {"linesearch": "DIVERGED_MAX_IT", "trust_region": "CONVERGED_FNORM_ABS"}
    assert p.energy(p.x) < 0.47 * energy
    if comm.size == 1:
        p.jacobian(p.x, "exact")
        assert np.linalg.eigvalsh(dense(p.A))[0] > 0
