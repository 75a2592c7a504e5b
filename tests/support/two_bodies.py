"""Two blocks that are pressed together, for the tests of contact between bodies."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import contact_problems
import numpy as np
from bodies import Condition, Hold, create_problem

from fem_snh.assembly.boundary_conditions import group_nodes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.contact.body_contact import BodyContact, BodyPair
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.problem.problem import Problem

#: The constants of LLNL's contact patch test, and its displacement.
K, G, PRESS = 10.0, 0.25, 0.01
E, NU = 9 * K * G / (3 * K + G), (3 * K - 2 * G) / (2 * (3 * K + G))
ROLLERS = [Hold("bottom", ("z",)), Hold("left", ("x",)), Hold("front", ("y",))]


class TwoBlocks:
    """A problem of two blocks of meshes/two_blocks.geo, the upper of which is pressed down.

    Parameters
    ----------
    comm : MPI.Comm
        The ranks.
    element : str
        The element of both.
    cells : (int, int)
        Cells along the edges of the lower and of the upper block.
    stiffness, augmented, tolerance
        As for `BodyPair`.
    press : float
        Displacement of the top at load 1, downwards.
    hold, components
        What is constrained beside the top, and which components of the top.
    **parameters
        Of the geometry.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        element: str = "Q1",
        cells: tuple[int, int] = (2, 2),
        stiffness: float | None = None,
        augmented: bool = False,
        tolerance: float | None = None,
        press: float = PRESS,
        hold: Any = ROLLERS,
        components: tuple[str, ...] = ("z",),
        **parameters: float,
    ) -> None:
        self.element = ELEMENTS[element]
        lower, upper = cells
        self.mesh = mesh.generate(
            comm, "two_blocks", self.element.cell, cells=lower, upper_cells=upper, **parameters
        )

        def loads(body: mesh.Mesh, u: Any, regions: Any, dirichlet: Any) -> list[BodyContact]:
            facets = (body.group(name).entities for name in ("lower_top", "upper_bottom"))
            pair = BodyPair("blocks", *facets, stiffness, augmented, tolerance)
            return [BodyContact(u.function_space, regions, [pair])]

        def move(X: np.ndarray, load: float) -> np.ndarray:
            return np.broadcast_to([0.0, 0.0, -press * load], X.shape).copy()

        self.problem: Problem = create_problem(
            self.mesh,
            self.element,
            material("stable_neo_hookean", E, NU),
            hold=hold,
            move=[Condition("top", move, components)],
            loads=loads,
        )
        self.contact: Any = self.problem.terms[1]

    def solve(self, tolerance: float = 1e-7) -> dict[str, Any]:
        """Press in one step and return its row; ``tolerance`` is that of the residual."""
        return contact_problems.press(self.problem, tolerance=tolerance)

    def values(self, group: str) -> tuple[np.ndarray, np.ndarray]:
        """Return reference coordinates and displacements of all ranks' nodes of a group."""
        V = self.problem.V
        nodes = group_nodes(V, self.mesh, group)
        local = V.tabulate_dof_coordinates()[nodes], self.problem.u.x.array.reshape(-1, 3)[nodes]
        gathered = V.mesh.comm.allgather(local)
        X, u = map(np.concatenate, zip(*gathered, strict=True))
        return X, u


def distance_from_affine(X: np.ndarray, u: np.ndarray) -> float:
    """Return the largest difference between displacements and their affine least-squares fit."""
    A = np.column_stack([X, np.ones(len(X))])
    return float(np.abs(A @ np.linalg.lstsq(A, u, rcond=None)[0] - u).max())
