"""The result of a fit: parameters with standard errors, residuals, stable ranges, the table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from fem_snh.arrays import Array, ArrayLike
from fem_snh.files import write_file
from fem_snh.studies.fit.data import TestData
from fem_snh.studies.fit.family import Family
from fem_snh.studies.fit.least_squares import BestFit
from fem_snh.studies.fit.responses import FREE, StableRange, response, stable_at, stable_ranges

if TYPE_CHECKING:
    from fem_snh.kernels.material import Material

#: Significant digits of the numbers in the table, more than data have.
_DIGITS = 10
#: R² of a test below which a fit has a note: two biaxial stresses that are exchanged have 0.46.
_POOR = 0.8
#: Smallest mean square in AICc, relative to the data's mean square: double precision resolves no
#: less.
_NO_RESIDUAL = 1e-24


@dataclass(frozen=True)
class TestResult:
    """A test and its fit.

    Attributes
    ----------
    data : TestData
        The measurement.
    stress : (n,)
        The stresses of the fit.
    """

    __test__ = False  # the name is not one of a test of pytest's

    data: TestData
    stress: Array

    @property
    def residual(self) -> Array:
        """Return the differences of the stresses, fit minus data, (n,)."""
        return self.stress - self.data.stress

    @property
    def rms(self) -> float:
        """Return the root mean square of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def largest(self) -> float:
        """Return the largest absolute residual."""
        return float(np.abs(self.residual).max())

    @property
    def r_squared(self) -> float:
        """Return the coefficient of determination R^2; NaN if the data do not vary."""
        return r_squared(self.data.stress, self.residual)


class Fit:
    """A material fitted to test data.

    Attributes
    ----------
    name : str
        The material.
    E, nu : float
        Young's modulus [Pa, or the unit of the data if they state none] and Poisson's ratio; nu =
        0.5 for an incompressible material.
    shape : dict
        Shape parameters, keywords of `fem_snh.material`.
    parameters, errors : dict
        The fitted numbers and their standard errors: E, entries such as "weights[1]", and nu if it
        was fitted. An error is infinite if the data do not determine the number, and NaN at a
        bound.
    units : dict
        The units of these numbers; "" for a dimensionless number, or if the data state none.
    tests : tuple of TestResult
        Data, stresses and residuals.
    stable : tuple of StableRange
        Stretches around rest that are stable by Drucker's criterion.
    evaluations, starts : int
        Evaluations of all stresses, and starts of the search.
    """

    def __init__(
        self,
        material: Any,
        family: Family,
        tests: Sequence[TestData],
        solution: BestFit,
        fit_nu: bool,
        searched: tuple[float, float],
    ) -> None:
        self.name, self._material = family.name, material
        self.E, self.nu = solution.E, solution.nu
        self.incompressible = family.incompressible
        self.shape = family.shape(solution.theta, self.E)
        sizes = [self.E if u.constant else 1.0 for u in family.unknowns]
        names = ["E", *(u.name for u in family.unknowns), *(["nu"] if fit_nu else [])]
        values = [self.E, *(solution.theta * sizes), *([self.nu] if fit_nu else [])]
        self.parameters = dict(zip(names, map(float, values), strict=True))
        self.errors = dict(zip(names, map(float, solution.errors), strict=True))
        dimensional = {"E", *(u.name for u in family.unknowns if u.constant)}
        self.units = {name: tests[0].unit if name in dimensional else "" for name in names}
        self.tests = tuple(map(TestResult, tests, solution.predicted))
        self.cost, self.evaluations, self.starts = (
            solution.cost, solution.evaluations, solution.starts,
        )  # fmt: skip
        self.searched = searched
        self._law = family.at(solution.theta, self.nu)
        self.stable: tuple[StableRange, ...] = stable_ranges(self._law, *searched)

    @property
    def notes(self) -> list[str]:
        """Return a line for each test that the material does not describe: of a low R^2."""
        return [
            f"{t.data.name}: R² = {t.r_squared:.2f}: {self.name} does not describe this test; are "
            "its kind and its columns those of the test?"
            for t in self.tests
            if t.r_squared < _POOR
        ]

    @property
    def r_squared(self) -> float:
        """Return R^2 over all tests."""
        return r_squared(
            np.concatenate([t.data.stress for t in self.tests]),
            np.concatenate([t.residual for t in self.tests]),
        )

    @property
    def rms(self) -> float:
        """Return the root mean square of the residuals of all tests."""
        return float(np.sqrt(np.mean(np.concatenate([t.residual for t in self.tests]) ** 2)))

    @property
    def aicc(self) -> float:
        """Return the corrected information criterion of Akaike (Burnham & Anderson 2002).

        Smaller is better: it weighs the sum of squares that the fit minimises, with the weights of
        the data, against the number of parameters.
        """
        n = sum(len(t.data.x) for t in self.tests)
        k = len(self.parameters) + 1  # and the variance
        scale = sum(float((t.data.weight * t.data.stress) @ t.data.stress) for t in self.tests)
        mean = max(self.cost, _NO_RESIDUAL * scale) / n
        correction = 2 * k * (k + 1) / (n - k - 1) if n > k + 1 else math.inf
        return n * math.log(mean) + 2 * k + correction

    @cached_property
    def stable_at_data(self) -> bool:
        """Return whether the fit is stable at all measured stretches of tests with free sides.

        Biaxial tests are examined at the measured points, others from rest to their extreme
        stretches.
        """
        return all(
            stable_at(self._law, t.data.kind, t.data.x, t.data.stretch_2)
            for t in self.tests
            if t.data.kind in (*FREE, "biaxial")
        )

    def stress(
        self,
        kind: str,
        x: ArrayLike,
        stretch_2: ArrayLike | None = None,
        measure: str = "stress",
    ) -> Array:
        """Return the stress of the fit in a test.

        Parameters
        ----------
        kind : str
            uniaxial, equibiaxial, planar, biaxial, simple_shear, volumetric or confined.
        x : (n,)
            Stretches; amounts of shear of simple_shear.
        stretch_2 : float or (n,), optional
            The second stretches of biaxial.
        measure : str
            "stress" is nominal; of biaxial also "stress_2" and "stress_difference", the difference
            of the true stresses.

        Returns
        -------
        (n,)
            NaN where there is no solution.
        """
        one, second = np.ones(1), cast("Array | None", stretch_2)
        t = TestData("stress", kind, cast("Array", x), one, one, second, measure)
        stress = self.E * response(self._law, kind, t.x, t.stretch_2, measure)
        return stress.reshape(np.shape(x))

    def material(self, nu: float | None = None) -> Material:
        """Return the fitted material.

        Parameters
        ----------
        nu : float, optional
            Another Poisson's ratio with the same shear modulus, to give an incompressible fit some
            compressibility.
        """
        from fem_snh.kernels.material import material  # imports the compiler's interface

        nu = self.nu if nu is None else nu
        return material(self._material, self.modulus_at(nu), nu, **self.shape)

    def modulus_at(self, nu: float) -> float:
        """Return Young's modulus for another nu with the same shear modulus."""
        return self.E * (1 + nu) / (1 + self.nu)

    def table(self) -> str:
        """Return the table ``[material]`` of a scene as TOML."""
        text = toml_table("material", {"name": self.name, "E": self.E, "nu": self.nu, **self.shape})
        text = text.replace("nu = 0.5\n", "nu = 0.5  # requires P2P1 or Q2Q1\n", 1)
        unit = self.units["E"]
        return text.replace("\nnu =", f"  # {unit}\nnu =", 1) if unit else text

    def record(self) -> dict[str, Any]:
        """Return the result as the content of fit.json."""
        return {
            "material": {"name": self.name, "E": self.E, "nu": self.nu, **self.shape},
            "incompressible": self.incompressible,
            "parameters": self.parameters,
            "standard_errors": {k: v if math.isfinite(v) else None for k, v in self.errors.items()},
            "units": self.units,
            "r_squared": self.r_squared,
            "rms": self.rms,
            "aicc": self.aicc if math.isfinite(self.aicc) else None,
            "tests": [
                {
                    "name": t.data.name,
                    "kind": t.data.kind,
                    "measure": t.data.measure,
                    "points": len(t.data.x),
                    "rms": t.rms,
                    "largest": t.largest,
                    "r_squared": t.r_squared,
                }
                for t in self.tests
            ],
            "stable": {s.kind: [s.low, s.high] for s in self.stable},
            "stable_at_data": self.stable_at_data,
            "searched": list(self.searched),
            "evaluations": self.evaluations,
            "starts": self.starts,
            "notes": self.notes,
        }

    def write(self, path: str | Path) -> Path:
        """Write `record` as JSON and return the path; raise BadInput if that fails."""
        return write_file(path, json.dumps(self.record(), indent=1) + "\n")

    def write_table(self, path: str | Path) -> Path:
        """Write `table` into a file and return the path; raise BadInput if that fails."""
        return write_file(path, self.table())

    def plot(self, path: str | Path) -> Path:
        """Draw data, fit and extrapolation; return the path, or raise BadInput if that fails."""
        from fem_snh.viewing.plots.materials import draw_fits  # matplotlib

        return draw_fits([self], Path(path))

    def __repr__(self) -> str:
        values = ", ".join(f"{k}={v:.6g}" for k, v in self.parameters.items())
        return f"<Fit of {self.name}: {values}; R^2={self.r_squared:.6g}>"


def r_squared(stress: Array, residual: Array) -> float:
    """Return the coefficient of determination R^2; NaN if the data do not vary."""
    varied = float(((stress - stress.mean()) ** 2).sum())
    return 1 - float(residual @ residual) / varied if varied > 0 else math.nan


def toml_table(name: str, values: Mapping[str, Any]) -> str:
    """Return a table of TOML, without the values that are None."""
    lines = [f"{key} = {json.dumps(_rounded(v))}" for key, v in values.items() if v is not None]
    return "\n".join([f"[{name}]", *lines]) + "\n"


def _rounded(value: Any) -> Any:
    """Return a value with the numbers in it rounded to `_DIGITS`."""
    if isinstance(value, tuple | list):
        return [_rounded(entry) for entry in value]
    if isinstance(value, bool | str):
        return value
    return float(f"{value:.{_DIGITS}g}")
