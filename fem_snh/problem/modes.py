r"""Eigenfrequencies and mode shapes about an equilibrium, by SLEPc.

They are the lowest solutions of

.. math:: K \varphi = \omega^2 M \varphi

over the free dofs, with the exact Hessian K of the energy and the consistent mass matrix M.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from time import perf_counter
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.problem.eigenproblem import Eigenproblem
from fem_snh.problem.problem import Problem

#: Largest relative residual of an eigenpair. SLEPc judges by estimates for the shifted inverse,
#: which are those of the pencil only as far as the factors are accurate.
_LARGEST_RESIDUAL = 1e-4


@dataclass
class VibrationModes:
    """The lowest modes of a problem, in ascending order.

    Attributes
    ----------
    problem : Problem
        The problem, in the state the modes are about.
    density : float
        Mean mass per reference volume [kg/m^3].
    mass : float
        The body's mass [kg].
    frequencies : list of float
        omega / (2 pi) [Hz]; -abs(omega) / (2 pi) where omega^2 < 0, in an unstable state.
    residuals : list of float
        ||K phi - omega^2 M phi|| / ((abs(omega^2) + E / (density length^2)) ||M phi||).
    shapes : list of PETSc.Vec
        Mode shapes [m], vectors like the problem's ``x`` with phi . M phi = mass length^2. The
        component with the largest absolute value is positive.
    seconds : float
        Time of the computation.
    """

    problem: Problem
    density: float
    mass: float
    frequencies: list[float]
    residuals: list[float]
    shapes: list[PETSc.Vec]
    seconds: float

    @property
    def record(self) -> dict[str, Any]:
        """The modes' entry in run.json."""
        return {
            "density": self.density,
            "mass": self.mass,
            "length": self.problem.length,
            "frequencies": self.frequencies,
            "residuals": self.residuals,
        }


def lowest(
    problem: Problem, density: float, count: int, prefix: str = "snh_modes_"
) -> VibrationModes:
    """Return the lowest modes about the state ``problem.x``. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    density : float
        Mass per reference volume [kg/m^3] of the regions that have none of their own.
    count : int
        Number of modes.
    prefix : str, optional
        Prefix of SLEPc's options, e.g. ``-snh_modes_eps_monitor``.

    Raises
    ------
    BadInput
        On every rank: see `check`; or if SLEPc does not converge, or its eigenpairs have a large
        residual.
    """
    start, assembly_seconds = perf_counter(), problem.seconds["assemble"]
    check(problem, count)
    with _library_errors():
        eigenproblem = Eigenproblem(problem, density, prefix)
        values, vectors = eigenproblem.lowest(count)
    problem.seconds["assemble"] = assembly_seconds  # assembly here counts as time of the modes
    residuals = [eigenproblem.residual(*pair) for pair in zip(values, vectors, strict=True)]
    if not max(residuals) <= _LARGEST_RESIDUAL:
        raise BadInput(
            f"modes: an eigenpair has the relative residual {max(residuals):.2g}, "
            f"more than {_LARGEST_RESIDUAL:g}: the factors of MUMPS are not accurate enough"
        )
    frequencies = np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)
    mass = eigenproblem.density * problem.length**3
    return VibrationModes(
        problem,
        eigenproblem.density,
        mass,
        frequencies.tolist(),
        residuals,
        [eigenproblem.shape(v, np.sqrt(mass) * problem.length) for v in vectors],
        perf_counter() - start,
    )


def check(problem: Problem, count: int) -> None:
    """Check before the load steps that the modes can be computed. Collective.

    Raises
    ------
    BadInput
        On every rank: fewer free dofs than modes, an unknown pressure, or SLEPc is missing.
    """
    if problem.saddle_point:
        raise BadInput(
            f"modes: element '{problem.element.name}' has a pressure without mass: "
            "take one with the displacement alone, P2P0 or Q1P0 where nu is close to 0.5"
        )
    free = problem.x.getLocalSize() - len(problem.constrained_dofs)
    free = problem.comm.allreduce(free)
    if count > free:
        raise BadInput(f"modes: count = {count}: there are only {free} free degrees of freedom")
    with _library_errors():
        import_module("slepc4py.SLEPc")


@contextmanager
def _library_errors() -> Iterator[None]:
    """Raise BadInput for a missing SLEPc and for an error of PETSc's."""
    try:
        yield
    except ImportError as error:
        raise BadInput(f"modes need slepc4py ({error}): install python3-slepc4py-real") from None
    except PETSc.Error as error:
        message = " ".join(str(error).split())
        raise BadInput(f"modes: PETSc with MUMPS failed: {message}") from None
