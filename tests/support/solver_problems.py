"""Problems and solves that the tests of the solver share."""

from __future__ import annotations

from contextlib import contextmanager

from petsc4py import PETSc

import numpy as np
from bodies import Condition, Hold, create_problem, cube, problem, set_values, wave

from fem_snh import solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.kernels.material import material

#: The trust region, entered where the filtered steps make little progress.
TRUST = {"hessian": "adaptive", "globalization": "trust_region"}


@contextmanager
def options(**values):
    """Set PETSc options under the solver's prefix inside the block; None for a flag."""
    database = PETSc.Options(solver.PREFIX)
    for key, value in values.items():
        database.setValue(key, value)
    try:
        yield
    finally:
        for key in values:
            database.delValue(key)


#: A direct solver keeps the symmetry of a state, so that unstable states are found.
SYMMETRIC = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def turned(angle, size=1.0):
    """Return a rotation about the vertical axis through the middle, proportional to the load."""
    middle = size * np.array([0.5, 0.5, 0])

    def displacement(X, load):
        return (X - middle) @ (rotation(load * angle).T - np.eye(3))

    return displacement


def twist(comm, element="Q1", name="stable_neo_hookean", cells=3, angle=0.6, size=1.0, **kwargs):
    body = cube(comm, ELEMENTS[element].cell, cells, 0.03, size)
    move = [Condition("top", turned(angle, size))]
    return problem(body, element, name, hold=[Hold("bottom")], move=move, **kwargs)


def solve(p, predictor="none", hessian="adaptive", globalization="linesearch"):
    """Solve one load step; return the SNES and its context."""
    snes = solver.create(p, hessian, globalization)
    solver.Predictor(p, snes, predictor).predict(1.0)
    snes.solve(None, p.x)
    return snes, snes.getPythonContext()


def half_turn(comm, cells, noise=0.0):
    """Return the twist of Smith et al. 2018 by half a turn, nu = 0.3: it has many equilibria."""
    p = create_problem(
        cube(comm, "hexahedron", cells),
        ELEMENTS["Q1"],
        material("stable_neo_hookean", nu=0.3),
        hold=[Hold("bottom")],
        move=[Condition("top", turned(np.pi))],
    )
    set_values(p, wave(noise))
    return p
