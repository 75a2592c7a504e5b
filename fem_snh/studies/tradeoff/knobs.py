"""The knobs of a run that cost something or change its answer, each value by name.

A `Choice` is one setting of all of them: the columns of the study's table, and what
`fem_snh.scenes.load` takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from fem_snh.choices import EIGENSOLVERS, HESSIANS
from fem_snh.errors import BadInput, choose
from fem_snh.fem.elements import ELEMENTS
from fem_snh.linalg.direct_solver import DIRECT_SOLVER

#: Incomplete factors, blocks of each rank.
ICC = {"pc_type": "bjacobi", "sub_pc_type": "icc"}
_U_ICC = {"fieldsplit_u_pc_type": "bjacobi", "fieldsplit_u_sub_pc_type": "icc"}

#: Linear solvers with their preconditioners: of the displacement alone, and of a saddle (there,
#: what it says is the preconditioner of the displacement's block).
SOLVERS: dict[bool, dict[str, dict[str, Any]]] = {
    False: {
        "cg+ssor": {},  # in single precision, fem_snh.solver.EisenstatCG
        "cg+jacobi": {"ksp_type": "cg", "pc_type": "jacobi"},
        "cg+icc": {"ksp_type": "cg", **ICC},
        "cg+gamg": {"ksp_type": "cg", "pc_type": "gamg"},
        "direct": DIRECT_SOLVER,
    },
    True: {
        "minres+hypre": {"fieldsplit_u_pc_type": "hypre"},
        "minres+gamg": {"fieldsplit_u_pc_type": "gamg"},
        "minres+icc": _U_ICC,
        "direct": DIRECT_SOLVER,
    },
}
#: Of every run: all elements have it.
GLOBALIZATION = "linesearch"
#: Where a knob is turned to, one at a time.
FORCINGS = (0.5, 0.1, 5e-3, 1e-8)
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9)
KNOBS = ("hessian", "solver", "forcing", "tolerance", "eigensolver")


@dataclass(frozen=True)
class Choice:
    """One way to solve a scene. Raises BadInput for what there is not.

    Attributes:
        element: see `fem_snh.fem.elements`.
        cells: of a built-in geometry; None: of a mesh file.
        mesh: the file; empty for a built-in geometry.
        hessian: exact, clamp, abs or adaptive.
        solver: a name in SOLVERS.
        forcing: largest relative tolerance of a linear solve, snes_forcing_max.
        tolerance: of the residual, snes_scaled_tol.
        eigensolver: of the Hessian's scaling block.
        steps: load steps; None: the scene's.
    """

    element: str
    cells: int | None
    mesh: str = ""
    hessian: str = "adaptive"
    solver: str = ""
    forcing: float = 0.1
    tolerance: float = 1e-7
    eigensolver: str = EIGENSOLVERS[0]
    steps: int | None = None

    def __post_init__(self) -> None:
        saddle = ELEMENTS[choose("element", self.element, ELEMENTS)].volume == "pressure"
        choose("hessian", self.hessian, HESSIANS)
        choose("eigensolver", self.eigensolver, EIGENSOLVERS)
        solver = self.solver or iterative(self.element)
        object.__setattr__(self, "solver", solver)
        choose(f"solver of {self.element}", solver, SOLVERS[saddle])
        for key in ("forcing", "tolerance"):
            number = getattr(self, key)
            plain = isinstance(number, int | float) and not isinstance(number, bool)
            if not plain or not number > 0:
                raise BadInput(f"{key} = {number}: expected a number > 0")

    @property
    def saddle(self) -> bool:
        """Whether a pressure is unknown, too."""
        return ELEMENTS[self.element].volume == "pressure"

    def values(self) -> dict[str, Any]:
        """As `fem_snh.scenes.load` takes it."""
        where = {"mesh": self.mesh} if self.mesh else {"cells": self.cells}
        petsc = SOLVERS[self.saddle][self.solver] | {
            "snes_forcing_max": self.forcing, "snes_scaled_tol": self.tolerance
        }  # fmt: skip
        plain = {key: getattr(self, key) for key in ("element", "hessian", "eigensolver")}
        plain["globalization"] = GLOBALIZATION
        plain |= {} if self.steps is None else {"steps": self.steps}
        return plain | where | {f"petsc.{key}": value for key, value in petsc.items()}

    def row(self) -> dict[str, Any]:
        """As columns of the table; what is None is the scene's."""
        row = {field.name: getattr(self, field.name) for field in fields(self)}
        return {key: value for key, value in row.items() if value is not None}

    def name(self) -> str:
        """One word for a folder: the same choice, the same word."""
        told: dict[str, Any] = {key: f"{getattr(self, key):g}" for key in ("forcing", "tolerance")}
        told |= {"mesh": Path(self.mesh).stem, "steps": self.steps and f"steps={self.steps}"}
        return "__".join(str(v) for v in (self.row() | told).values() if v not in ("", None))

    def turned(self) -> Iterator[Choice]:
        """The same with one knob elsewhere.

        How exactly linear systems are solved is nothing to a direct solver: that knob is turned
        with an iterative one.
        """
        for knob in KNOBS:
            base = self
            if knob == "forcing" and self.solver == "direct":
                base = replace(self, solver=iterative(self.element))
            for value in positions(self.element)[knob]:
                if getattr(base, knob) != value or base != self:
                    yield replace(base, **{knob: value})


def iterative(element: str) -> str:
    """The name of the solver that an element has by default."""
    return next(iter(SOLVERS[ELEMENTS[element].volume == "pressure"]))


def positions(element: str) -> Mapping[str, tuple[Any, ...]]:
    """For each knob the values that it takes with this element."""
    return {
        "hessian": HESSIANS,
        "solver": tuple(SOLVERS[ELEMENTS[element].volume == "pressure"]),
        "forcing": FORCINGS,
        "tolerance": TOLERANCES,
        "eigensolver": EIGENSOLVERS,
    }
