"""The modes of vibration of a dolfinx program."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

from fem_snh.errors import bad_value, check_number, check_whole
from fem_snh.problem.dolfinx_problem import check_converged
from fem_snh.problem.modes import PREFIX, LowestModes, check
from fem_snh.problem.problem import Problem
from fem_snh.tables.types import INT32_MAX


class ProgramModes:
    """The lowest modes of vibration about a solution of a program.

    A pair of them and a number from 1, ``(modes, 1)``, is a goal of
    ``NonlinearProblem.estimate_error``: one frequency. The modes alone are all of them.

    Attributes
    ----------
    frequencies : list of float
        omega / (2 pi) [Hz] in ascending order; -abs(omega) / (2 pi) where omega^2 < 0, in an
        unstable state.
    shapes : list of dolfinx Function
        Mode shapes [m] in the displacement's space. Their mean square over the mass is the square
        of V^(1/3), in two dimensions of the root of the area; the component with the largest
        absolute value is positive.
    residuals : list of float
        ||K phi - omega^2 M phi|| / ((abs(omega^2) + E / (density V^(2/3))) ||M phi||).
    density : float
        Mean mass per reference volume [kg/m^3].
    mass : float
        The body's mass [kg]; of a plane, per thickness [kg/m].
    """

    def __init__(self, problem: Problem, lowest: LowestModes) -> None:
        found = lowest(problem)
        self._problem, self._state, self._lowest = problem, problem.x.copy(), lowest
        self.frequencies, self.residuals = found.frequencies, found.residuals
        self.density, self.mass = found.density, found.mass
        self.shapes = [found.function(i) for i in range(1, len(found.shapes) + 1)]

    def __str__(self) -> str:
        return ", ".join(f"{frequency:.6g}" for frequency in self.frequencies) + " Hz"

    def of_state(self, problem: Problem) -> LowestModes | None:
        """Return what computes the modes; None if they are not those of its state. Collective."""
        if problem is not self._problem or not self._state.equal(problem.x):
            return None
        return self._lowest


class HasModes:
    """Frequencies and mode shapes, a method of `fem_snh.NonlinearProblem`."""

    _problem: Problem
    _prefix: str
    reason: str

    def vibration_modes(self, count: int, density: float | None = None) -> ProgramModes:
        """Return the lowest modes of vibration about the last solution. Collective.

        They are those of small vibrations of the loaded body, with the exact Hessian and the
        consistent mass matrix, computed by SLEPc (python3-slepc4py-real). Its options have the
        solver's prefix, followed by ``modes_``: ``-snh_modes_eps_monitor``.

        Parameters
        ----------
        count : int
            Number of modes, from the lowest.
        density : float, optional
            Mass per reference volume [kg/m^3] of the materials that ``densities`` does not have,
            and of a body without materials, whose energy is in UFL.

        Returns
        -------
        ProgramModes
            ``frequencies`` [Hz] and ``shapes``, dolfinx Functions.

        Raises
        ------
        BadInput
            On every rank: before a solution, for a missing density, more modes than free dofs, an
            element with an unknown pressure, a force or a material without an energy, a cavity, a
            motion in time; or if the eigenvalue solver fails.

        Examples
        --------
        >>> modes = problem.vibration_modes(3, density=1000.0)
        >>> print(modes.frequencies[0], modes.shapes[0].x.array.max())
        >>> print(problem.estimate_error([(modes, 1)]))
        frequency.1 0.1647, error -0.0025 (1.5 %), corrected 0.1622
        """
        check_whole("count", count, 1, INT32_MAX)
        regions = self._problem.regions
        if density is not None:
            check_number("density", density, 0.0, exclusive=True)
        elif not regions or any(region.density is None for region in regions):
            accepted = "a number > 0 [kg/m^3], or 'densities' of all materials of the problem"
            raise bad_value("density", None, accepted)
        check(self._problem, count)
        check_converged(self.reason, "vibration_modes")
        lowest = LowestModes(density, count, self._prefix + PREFIX)
        with self._petsc_options():
            return ProgramModes(self._problem, lowest)

    def _petsc_options(self) -> AbstractContextManager[Any]:
        raise NotImplementedError
