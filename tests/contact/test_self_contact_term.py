"""Self-contact as a term of `NonlinearProblem` and `DynamicProblem`, in a dolfinx program."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from barrier_problems import needs_ipctk
from dolfinx import fem
from dolfinx_programs import vector_space
from running import solve
from test_reference_contact import CLIP

import fem_snh
from fem_snh import _dolfinx, scenes
from fem_snh.assembly.boundary_conditions import group_nodes
from fem_snh.mesh import mesh

mpi = pytest.mark.mpi
MATERIAL = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.45)
#: Displacement of each jaw of the clip [m]: more than half of the gap between them, 0.15.
CLOSE = 0.17


def clip(comm: Any, kind: Any, **arguments: Any) -> tuple[Any, Any]:
    """Return a problem of the clip and the function that closes it by a part."""
    body = mesh.generate(comm, "clip", "hexahedron", cells=2, gap=0.3)
    V = vector_space(body.domain)
    u, prescribed = fem.Function(V), fem.Function(V)
    nodes = {key: group_nodes(V, body, key) for key in ("bottom", "top")}
    bcs = [_dolfinx.prescribed(prescribed, np.unique(np.concatenate(list(nodes.values()))))]

    def close(part: float) -> None:
        values = prescribed.x.array.reshape(-1, 3)
        values[nodes["bottom"], 2], values[nodes["top"], 2] = CLOSE * part, -CLOSE * part

    return kind(u, {MATERIAL: ufl.dx}, bcs=bcs, **arguments), close


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("method", ["reference", pytest.param("ipc", marks=needs_ipctk)])
def test_a_program_has_the_self_contact_of_a_scene(comm, method):
    jaws = [{"group": g, "translate": [0, 0, z]} for g, z in (("bottom", CLOSE), ("top", -CLOSE))]
    changes = {"self_contact": {"method": method}, "move": jaws, "predictor": "tangent"}
    expected = solve(scenes.Scene(**(CLIP | changes)), comm)
    assert expected.steps[-1]["self_contact"]["force"] > 0
    contact = fem_snh.SelfContact(method)
    problem, close = clip(comm, fem_snh.NonlinearProblem, terms=[contact])
    for part in (0.5, 1.0):
        close(part)
        problem.solve()
        assert problem.solver.getConvergedReason() > 0
    error = np.abs(problem.u.x.array - expected.u.x.array).max(initial=0.0)
    assert comm.allreduce(error, op=max) < 1e-9


@pytest.mark.one_debian
@mpi
def test_a_body_in_motion_touches_itself(comm):
    """Without contact the jaws overlap by the distance that they pass beyond the gap."""
    overlaps = []
    for terms in ([], [fem_snh.SelfContact()]):
        shut: list[Any] = []
        problem, close = clip(
            comm, fem_snh.DynamicProblem, densities={MATERIAL: 100.0}, duration=1.0,
            integrator="backward_euler", set_time=lambda t, shut=shut: shut[0](t**2),
            terms=terms,
        )  # fmt: skip
        shut.append(close)
        for _ in range(4):
            assert problem.step(0.25)
        overlaps.append(jaws_overlap(problem.u))
    assert overlaps[0] > 0.04 and overlaps[1] < 0.005


def jaws_overlap(u: Any) -> float:
    """Return how far the lower jaw's nodes are above the upper's, at most. Collective."""
    V = u.function_space
    comm, X = V.mesh.comm, V.tabulate_dof_coordinates()
    z = X[:, 2] + u.x.array.reshape(-1, 3)[:, 2]
    middle = 0.5 * (comm.allreduce(X[:, 2].max(), op=max) + comm.allreduce(X[:, 2].min(), op=min))
    near = np.abs(X[:, 2] - middle) < 0.16  # the faces of the jaws are 0.15 from the middle
    low, high = z[near & (X[:, 2] < middle)], z[near & (X[:, 2] > middle)]
    top = comm.allreduce(low.max(initial=-np.inf), op=max)
    return float(top - comm.allreduce(high.min(initial=np.inf), op=min))


@mpi
@needs_ipctk
def test_a_barrier_in_motion(comm):
    """The first guess, by the velocity, would pass through the other jaw; no state does."""
    gaps, shut = [], []
    problem, close = clip(
        comm, fem_snh.DynamicProblem, densities={MATERIAL: 100.0}, duration=1.0,
        integrator="backward_euler", set_time=lambda t: shut[0](t**2),
        terms=[fem_snh.SelfContact("ipc", distance=0.01)],
    )  # fmt: skip
    shut.append(close)
    for row in problem.steps(6):
        assert row["converged"], problem.reason
        gaps.append(-jaws_overlap(problem.u))
    assert problem.time == 1 and min(gaps) > 0
    assert gaps[-1] < 0.011 and row["self_contact"]["pairs"] > 0
