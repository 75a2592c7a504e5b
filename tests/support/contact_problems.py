"""Bodies and rigid obstacles for tests: their problems, at rest and in time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from petsc4py import PETSc

import numpy as np
from bodies import create_problem

from fem_snh import solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Filling
from fem_snh.contact.obstacle_contact import ObstacleContact, RigidContact
from fem_snh.geometry.motions import DisplacementMotion, MovingShape
from fem_snh.geometry.shapes import Plane
from fem_snh.kernels.material import material
from fem_snh.steps.dynamics.dynamics import Dynamics
from fem_snh.steps.stepping import Stepper, StepSolver
from fem_snh.terms.loads import Gravity


def translation(vector):
    """A motion by ``vector`` at load 1."""
    return DisplacementMotion(
        lambda X, load: np.tile(load * np.asarray(vector, float), (len(X), 1))
    )


def plane(point=(0, 0, 0), normal=(0, 0, 1), motion=None):
    return MovingShape(Plane(tuple(map(float, point)), tuple(map(float, normal))), motion)


def constant(load):
    return 1.0


def contact_problem(
    body: Any,
    element: str,
    contacts: list[RigidContact],
    *,
    E: float = 1.0,
    nu: float = 0.3,
    density: float | None = None,
    gravity: Any = None,
    amplitude: Any = float,
    sideways: Any = None,
    time: dict[str, Any] | None = None,
    **conditions: Any,
) -> tuple[Any, ObstacleContact, Dynamics | None]:
    """Return a problem, its contact, and with ``time`` (arguments of Dynamics) its dynamics.

    ``sideways`` is a second gravity with its amplitude.
    """
    made: list[ObstacleContact] = []

    def terms(mesh, u, regions, dirichlet):
        made.append(ObstacleContact(u.function_space, regions, contacts))
        return made

    weights = [(gravity, amplitude), sideways or (None, None)]
    p = create_problem(
        body,
        ELEMENTS[element],
        [Filling(material("stable_neo_hookean", E=E, nu=nu), None, density)],
        loads=terms,
        features=[Gravity(*weight) for weight in weights if weight[0] is not None],
        motion=(lambda *body: Dynamics(*body, **time)) if time else None,
        **conditions,
    )
    return p, made[0], p.motion


def accurate_snes(p, tolerance=1e-11):
    options, key = PETSc.Options(solver.PREFIX), "snes_scaled_tol"
    options[key] = tolerance
    snes = solver.create(p)
    options.delValue(key)
    return snes


def press(p: Any, steps: int = 1, tolerance: float = 1e-11) -> dict[str, Any]:
    """Solve load steps and return the last row."""
    stepper = Stepper(StepSolver(p, accurate_snes(p, tolerance), "none"), steps)
    rows = list(stepper)
    assert stepper.done, stepper.failure_message()
    assert all(row["converged"] for row in rows)
    return rows[-1]


def march(p, dynamics, steps, velocity=None, tolerance=1e-11) -> Iterator[dict[str, Any]]:
    """Solve time steps, or make linearised ones; yield the obstacles' rows, with ``solves``."""
    snes = accurate_snes(p, tolerance)
    linearised = dynamics.integrator.name == "semi_implicit"
    p.set_load(0.0)
    dynamics.start(p, velocity)
    for step in range(1, steps + 1):
        u = partial(lambda p: p.split(p.x)[0], p)
        p.history.begin_step(u())
        dynamics.begin_step(p, step / steps)
        p.set_load(step / steps)
        if linearised:
            assert solver.solve_linearised(p, snes).converged
        else:
            p.prescribe(p.x)
            again = True
            while again:
                snes.solve(None, p.x)
                assert snes.getConvergedReason() > 0
                again = p.history.update_lagged(u())
        dynamics.end_step(p)
        p.history.end_step(u())
        rows = p.history.record(u()).get("obstacles", {})
        yield {name: row | {"solves": p.history.solves} for name, row in rows.items()}


def nodes_mean(p):
    """Return the mean displacement of the nodes, (3,). Collective."""
    local = p.x.array_r[: 3 * len(p.coordinates)].reshape(-1, 3)
    total, count = p.comm.allreduce(local.sum(axis=0)), p.comm.allreduce(len(local))
    return total / count
