"""Fit a material to test data, or rank materials: `fem_snh.fit` and the command ``fit``.

`data` reads files; `family` is the energy as a function of the unknown parameters; `responses`
evaluates stress and stability in the tests; `least_squares` searches; `result` is the result.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fem_snh import materials
from fem_snh.errors import BadInput, bad_value, check_number
from fem_snh.files import write_file
from fem_snh.materials.parameters import default_variants
from fem_snh.studies.fit.data import TestData, read
from fem_snh.studies.fit.family import Family
from fem_snh.studies.fit.least_squares import NU_START, solve
from fem_snh.studies.fit.responses import FREE
from fem_snh.studies.fit.result import Fit

__all__ = ["Fit", "TestData", "fit", "ordered", "rank", "write_ranking"]

#: Tests whose stress depends only or mostly on the compressibility.
_OF_VOLUME = ("volumetric", "confined")
#: The range in which stability is searched extends beyond the data by this factor, and contains
#: these stretches.
_BEYOND, _AT_LEAST = 1.25, (0.5, 2.0)


def fit(
    material: Any,
    *data: str | Path | TestData,
    nu: float | None = None,
    parameters: Sequence[str] | None = None,
    held: Mapping[str, Any] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    relative: bool = False,
    stable_range: tuple[float, float] | None = None,
    test: Sequence[str] | str | None = None,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    modulus_unit: str | None = None,
    weights: Sequence[float] | None = None,
) -> Fit:
    """Fit a material to test data by bounded least squares.

    Parameters
    ----------
    material : str or callable
        As for `fem_snh.material`.
    *data : str, Path or TestData
        Files of test data; several are fitted together.
    nu : float, optional
        Poisson's ratio; 0.5 is an incompressible material. By default nu is fitted if there are
        volumetric or confined tests, and otherwise 0.5.
    parameters : sequence of str, optional
        The shape parameters that are fitted, besides E; all that are numbers by default. "alpha" is
        the nonlinearity of any material.
    held : mapping, optional
        Values of shape parameters that are not fitted.
    bounds : mapping, optional
        (lowest, highest) values of parameters; constants in units of E.
    relative : bool
        Minimise differences relative to the measured stresses.
    stable_range : (float, float), optional
        Stretches between which stability is evaluated; by default the range of the data, extended.
    test, columns, unit, weights : optional
        Kind of each file's test, names of the columns, unit of the stresses and weight of each
        file, where the files do not state them.
    modulus_unit : str, optional
        Unit of E and of the constants, such as MPa for a scene in mm; by default Pa, or the unit of
        data that state none.

    Returns
    -------
    Fit

    Raises
    ------
    BadInput
        For invalid arguments or files, or if no fit is found.

    Notes
    -----
    Stresses of an incompressible material do not depend on its volume term. E and the shape
    parameters determine the constants in the literature, with mu_lame = E/3.
    """
    tests = read_all(data, test, columns, unit, modulus_unit, weights)
    incompressible, fit_nu, nu = _compressibility(tests, nu)
    searched = _searched(tests, stable_range)
    held = dict(held or {})
    if fit_nu:  # the variant of the first ratio
        held |= default_variants(materials.function(material), nu, held)
    keywords = (held, parameters, bounds)
    family = Family(material, incompressible, nu, *keywords)
    solution = solve(family, tests, None if incompressible else nu, relative, fit_nu)
    if fit_nu and family.depends_on_nu:
        family = Family(material, incompressible, solution.nu, *keywords)
        solution = solve(family, tests, None, relative, fit_nu)
    return Fit(material, family, tests, solution, fit_nu, searched)


def rank(*data: str | Path | TestData, **keywords: Any) -> Iterator[Fit | tuple[str, str]]:
    """Fit every material of `fem_snh.materials()`, in the order of their names.

    Parameters
    ----------
    *data, **keywords
        As for `fit`.

    Yields
    ------
    Fit or (str, str)
        The fit, or the name of a material that cannot be fitted and the reason. `ordered` sorts
        the fits.

    Raises
    ------
    BadInput
        For invalid files.
    """
    of_files = ("test", "columns", "unit", "modulus_unit", "weights")
    tests = read_all(data, **{key: keywords.pop(key, None) for key in of_files})
    for name in materials.names():
        try:
            yield fit(name, *tests, **keywords)
        except BadInput as error:
            yield name, str(error)


def ordered(fits: Sequence[Fit]) -> list[Fit]:
    """Return fits from the best to the worst: those stable at all data first, then by AICc."""
    return sorted(fits, key=lambda f: (not f.stable_at_data, f.aicc))


def write_ranking(fits: Sequence[Fit], path: Path) -> None:
    """Write fits in their order as CSV; raise BadInput if ``path`` cannot be written."""
    rows = [
        {
            "rank": place,
            "material": f.name,
            "parameters": len(f.parameters),
            "r_squared": f.r_squared,
            "rms": f.rms,
            "aicc": f.aicc,
            "stable_at_data": f.stable_at_data,
        }
        | {f"stable_{s.kind}": f"{s.low:.6g} to {s.high:.6g}" for s in f.stable}
        for place, f in enumerate(fits, start=1)
    ]
    write_file(path, pd.DataFrame(rows).to_csv(index=False))


def read_all(
    data: Sequence[str | Path | TestData],
    test: Sequence[str] | str | None = None,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    modulus_unit: str | None = None,
    weights: Sequence[float] | None = None,
) -> list[TestData]:
    """Return the tests of all files.

    Raises
    ------
    BadInput
        Without files, and for an invalid one.
    """
    if not data:
        raise BadInput("fit: no test data: expected the name of a file")
    tests = _each("test", [test] if isinstance(test, str) else test, len(data))
    loads = _each("weights", weights, len(data))
    for value in loads:
        if value is not None:
            check_number("weights", value, 0, exclusive=True)
    found: list[TestData] = []
    for given, kind, weight in zip(data, tests, loads, strict=True):
        if isinstance(given, TestData):
            found.append(given)
        else:
            found += read(given, kind, columns, unit, weight, modulus_unit)
    units = {t.unit: t.name for t in found}
    if len(units) > 1 and "" in units:
        named = next(name for unit, name in units.items() if unit)
        raise BadInput(
            f"{units['']}: stresses without a unit beside those of {named}: expected units of all, "
            "or of none"
        )
    return found


def _each(key: str, values: Sequence[Any] | None, count: int) -> list[Any]:
    """Return one value for each of ``count`` files; raise BadInput for another number of values."""
    given = [None] if values is None else list(values)
    if len(given) not in (1, count):
        raise bad_value(key, given, f"one value, or one for each of {count} files")
    return given * count if len(given) == 1 else given


def _compressibility(tests: Sequence[TestData], nu: float | None) -> tuple[bool, bool, float]:
    """Return whether the material is incompressible, whether nu is fitted, and the (first) nu."""
    volume = [t for t in tests if t.kind in _OF_VOLUME]
    if nu is not None:
        check_number("nu", nu, -1, highest=0.5, exclusive=True)
        if nu == 0.5 and volume:
            raise BadInput(
                f"{volume[0].name}: a test '{volume[0].kind}' of an incompressible material: "
                "expected nu = a number below 0.5, or none to fit it"
            )
        return nu == 0.5, False, float(nu)
    return (False, True, NU_START) if volume else (True, False, 0.5)


def _searched(tests: Sequence[TestData], given: tuple[float, float] | None) -> tuple[float, float]:
    """Return the stretches between which stability is evaluated."""
    if given is not None:
        low, high = given
        check_number("range", low, 0, highest=1, exclusive=True)
        check_number("range", high, 1)
        return float(low), float(high)
    x = [t.x for t in tests if t.kind in (*FREE, "biaxial")]
    x += [t.stretch_2 for t in tests if t.stretch_2 is not None]
    every = np.concatenate([_AT_LEAST, *x])
    return float(every.min()) / _BEYOND, float(every.max()) * _BEYOND
