"""The settings of a run that change its cost or its result ("knobs"), and their values.

A `Choice` sets all of them: it gives the columns of the table and the keyword arguments of
`fem_snh.scenes.load`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from fem_snh.assembly.elements import ELEMENTS
from fem_snh.choices import HESSIANS
from fem_snh.errors import BadInput, choose

#: Incomplete Cholesky factors of the diagonal block of each rank.
ICC = {"pc_type": "bjacobi", "sub_pc_type": "icc"}
_MINRES = {"ksp_type": "minres"}
_U_ICC = {"fieldsplit_u_pc_type": "bjacobi", "fieldsplit_u_sub_pc_type": "icc"}

#: The value of a knob that leaves the choice to the program, as run.json records it.
AUTOMATIC = "automatic"
#: The program's linear solvers by name, each for every problem.
_ITERATIVE, _DIRECT = {"snes_linear_solver": "iterative"}, {"snes_linear_solver": "direct"}
_DISPLACEMENT = {
    "cg+ssor": _ITERATIVE,  # in single precision, fem_snh.solver.EisenstatCG
    "cg+jacobi": {"ksp_type": "cg", "pc_type": "jacobi"},
    "cg+icc": {"ksp_type": "cg", **ICC},
    "cg+gamg": {"ksp_type": "cg", "pc_type": "gamg"},
    "direct": _DIRECT,
}
#: With the pressure of each cell as an unknown (`static_condensation = false`).
_MIXED = {"mixed+fgmres": _ITERATIVE, "mixed+direct": _DIRECT}
#: Linear solvers by the element's treatment of the volume term. With a pressure, the second part of
#: a name is the preconditioner of the displacement block.
SOLVERS: dict[str, dict[str, dict[str, Any]]] = {
    "pointwise": {AUTOMATIC: {}, **_DISPLACEMENT},
    "mean": {AUTOMATIC: {}, **_DISPLACEMENT, **_MIXED},
    "pressure": {
        AUTOMATIC: {},
        "fgmres+ssor": _ITERATIVE,  # inner CG in single precision, fem_snh.solver.saddle_point
        "minres+hypre": _MINRES | {"fieldsplit_u_pc_type": "hypre"},
        "minres+gamg": _MINRES | {"fieldsplit_u_pc_type": "gamg"},
        "minres+icc": _MINRES | _U_ICC,
        "direct": _DIRECT,
    },
}
#: The globalization of the runs that name a Hessian, as all elements have it.
GLOBALIZATION = "linesearch"
#: Values of forcing and tolerance.
FORCINGS = (0.5, 0.1, 5e-3, 1e-8)
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9)
KNOBS = ("hessian", "solver", "forcing", "tolerance")


@dataclass(frozen=True)
class Choice:
    """The settings of one run.

    Parameters
    ----------
    element : str
        A name of `fem_snh.assembly.elements`.
    cells : int, optional
        Cells of a built-in geometry; None for a mesh file.
    mesh : str
        The mesh file; empty for a built-in geometry.
    hessian : str
        Automatic, or exact, clamp, abs or adaptive with a line search.
    solver : str
        A name of `SOLVERS`.
    forcing : float
        Largest relative tolerance of a linear solve, -snes_forcing_max.
    tolerance : float
        Tolerance of the residual, -snes_scaled_tol.
    steps : int, optional
        Load steps; None: those of the scene.

    Raises
    ------
    BadInput
        For an unknown value.
    """

    element: str
    cells: int | None
    mesh: str = ""
    hessian: str = AUTOMATIC
    solver: str = AUTOMATIC
    forcing: float = 0.1
    tolerance: float = 1e-7
    steps: int | None = None

    def __post_init__(self) -> None:
        choose("element", self.element, ELEMENTS)
        choose("hessian", self.hessian, (AUTOMATIC, *HESSIANS))
        choose(f"solver of {self.element}", self.solver, solvers(self.element))
        for key in ("forcing", "tolerance"):
            number = getattr(self, key)
            plain = isinstance(number, int | float) and not isinstance(number, bool)
            if not plain or not number > 0:
                raise BadInput(f"{key} = {number}: expected a number > 0")

    @property
    def mixed(self) -> bool:
        """Return whether the solver is one of cell pressures as unknowns."""
        return self.solver in _MIXED

    def values(self) -> dict[str, Any]:
        """Return the keyword arguments of `fem_snh.scenes.load`."""
        where = {"mesh": self.mesh} if self.mesh else {"cells": self.cells}
        petsc = solvers(self.element)[self.solver] | {
            "snes_forcing_max": self.forcing, "snes_scaled_tol": self.tolerance
        }  # fmt: skip
        plain: dict[str, Any] = {"element": self.element}
        if self.hessian != AUTOMATIC:
            plain |= {"hessian": self.hessian, "globalization": GLOBALIZATION}
        if ELEMENTS[self.element].volume == "mean" and self.solver != AUTOMATIC:
            plain["static_condensation"] = not self.mixed
        plain |= {} if self.steps is None else {"steps": self.steps}
        return plain | where | {f"petsc.{key}": value for key, value in petsc.items()}

    def row(self) -> dict[str, Any]:
        """Return the columns of the table; None (a value of the scene) is left out."""
        row = {field.name: getattr(self, field.name) for field in fields(self)}
        return {key: value for key, value in row.items() if value is not None}

    def name(self) -> str:
        """Return the name of the folder, which is unique for these settings."""
        numbers: dict[str, Any] = {
            key: number_text(getattr(self, key)) for key in ("forcing", "tolerance")
        }
        numbers |= {"mesh": Path(self.mesh).stem, "steps": self.steps and f"steps={self.steps}"}
        return "__".join(str(v) for v in (self.row() | numbers).values() if v not in ("", None))

    def variations(self) -> Iterator[Choice]:
        """Yield these settings with one knob changed.

        The forcing term has no effect on a direct solver: it is varied with an iterative one.
        """
        for knob in KNOBS:
            base = self
            if knob == "forcing" and self.solver.endswith("direct"):
                base = replace(self, solver=iterative(self.element))
            for value in knob_values(self.element)[knob]:
                if getattr(base, knob) != value or base != self:
                    yield replace(base, **{knob: value})


def number_text(number: float) -> str:
    """Return a number in six digits, or in all if it has more: no two have the same text."""
    return text if float(text := f"{number:g}") == number else repr(number)


def solvers(element: str) -> Mapping[str, dict[str, Any]]:
    """Return the linear solvers of an element by name, with their PETSc options."""
    return SOLVERS[ELEMENTS[element].volume]


def iterative(element: str) -> str:
    """Return the program's iterative solver of an element."""
    return next(name for name, options in solvers(element).items() if options == _ITERATIVE)


def knob_values(element: str) -> Mapping[str, tuple[Any, ...]]:
    """Return the values of each knob for an element."""
    # Of Taylor-Hood elements the automatic choice is adaptive with a line search.
    same = ("adaptive",) if ELEMENTS[element].volume == "pressure" else ()
    return {
        "hessian": (AUTOMATIC, *(name for name in HESSIANS if name not in same)),
        "solver": tuple(solvers(element)),
        "forcing": FORCINGS,
        "tolerance": TOLERANCES,
    }
