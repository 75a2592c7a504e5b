"""The report of one material, ``Material.report``, and a table of several materials' stability."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fem_snh import materials
from fem_snh.errors import BadInput
from fem_snh.files import write_file
from fem_snh.kernels.material import Material, material
from fem_snh.kernels.reports import curves, stability
from fem_snh.kernels.reports.curves import Curve, StableRegion
from fem_snh.kernels.reports.stability import Stability
from fem_snh.records.run_record import table_text

#: The columns in order; the columns ``*_reason`` give the reason of a verdict that is not "passed".
COLUMNS = (
    "name", "nu", "mu_lame", "lambda_lame",
    "inversion", "reflection", "rest", "degeneracy",
    "inversion_reason", "reflection_reason", "rest_reason", "degeneracy_reason",
    "domain", "stretches", "note",
)  # fmt: skip


@dataclass(frozen=True)
class Report:
    """Stability, admissible region and stress curves of a material; printable.

    Attributes
    ----------
    name : str
        The material.
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    shape : dict
        Values of the shape parameters and of the given tuning keywords, by name.
    constants : dict
        The material's own constants [Pa] by name, fitted to E and nu.
    mu_lame, lambda_lame : float
        Small-strain constants [Pa], by differentiation of the energy at rest.
    rest_stress : float
        Principal PK1 stress at F = I [Pa].
    has_energy : bool
        True if the stress is the gradient of an energy.
    domain : tuple of str
        Expressions that are positive where the energy is finite.
    needs_stretches : bool
        True if energy and stress need the singular values of F.
    inversion, reflection, rest, degeneracy : Stability
        The four stability properties of Smith et al. 2018.
    curves : tuple of Curve
        Uniaxial, equibiaxial, simple shear and volumetric stress curves.
    regions : tuple of StableRegion
        Smallest eigenvalues of the exact tangent over planes of stretches.
    """

    name: str
    E: float
    nu: float
    shape: dict[str, Any]
    constants: dict[str, float]
    mu_lame: float
    lambda_lame: float
    rest_stress: float
    has_energy: bool
    domain: tuple[str, ...]
    needs_stretches: bool
    inversion: Stability
    reflection: Stability
    rest: Stability
    degeneracy: Stability
    curves: tuple[Curve, ...]
    regions: tuple[StableRegion, ...]

    @property
    def stabilities(self) -> tuple[Stability, Stability, Stability, Stability]:
        """Return the four stability properties, in the order of Smith et al. 2018."""
        return self.inversion, self.reflection, self.rest, self.degeneracy

    def plot(self, path: str | Path) -> Path:
        """Draw the report to the image file ``path``; return it. Raises BadInput on failure."""
        from fem_snh.viewing.plots.materials import draw_report

        return draw_report(self, Path(path))

    def __str__(self) -> str:
        return "\n".join(_lines(self))


def report(m: Material) -> Report:
    """Return the report of a material, computed in half a second once the kernel is compiled."""
    return Report(
        name=m.name,
        E=m.expression.E,
        nu=m.expression.nu,
        shape=dict(m.expression.shape),
        constants={
            str(c): v for c, v in zip(m.expression.constants, m.expression.values, strict=True)
        },
        mu_lame=m.lame[0],
        lambda_lame=m.lame[1],
        rest_stress=m.expression.rest_stress,
        has_energy=m.expression.has_energy,
        domain=tuple(map(str, m.expression.domain)),
        needs_stretches=m.expression.needs_stretches,
        **{s.name: s for s in stability.properties(m)},
        curves=curves.curves(m),
        regions=curves.regions(m),
    )


def _lines(r: Report) -> list[str]:
    own = ", ".join(f"{k} = {v}" for k, v in r.shape.items() if v is not None)
    constants = ", ".join(f"{k} = {v:.6g}" for k, v in r.constants.items())
    where = domain(r.domain)
    lines = [
        f"{r.name}: E = {r.E:g} Pa, nu = {r.nu:g}" + (f", {own}" if own else ""),
        "",
        f"constants        {constants} [Pa]",
        f"Lame constants   mu = {r.mu_lame:.6g}, lambda = {r.lambda_lame:.6g} [Pa], derived",
        f"stress at rest   {r.rest_stress:.6g} Pa",
        f"energy           {'finite for ' + where if r.has_energy else 'none, only a stress'}",
        "computed from    "
        + ("the stretches (an SVD for energy and stress)" if r.needs_stretches else "I_C, II_C, J"),
        "",
        "Stability (numbers in units of E):",
    ]
    for s in r.stabilities:
        lines.append(f"  {s.name:<13}  {s}")
        numbers = ", ".join(f"{k} {_short(v)}" for k, v in s.numbers.items())
        lines += [f"  {'':<13}  {numbers}"] if numbers else []
    return lines


def domain(positive: tuple[str, ...]) -> str:
    """Return the condition for a finite energy as text, e.g. "J > 0"; "every F" for none."""
    left = set(positive)
    products = {d for d in left if re.fullmatch(r"[s\d*/()]+", d)}  # products and powers of s0..s2
    if {"s0", "s1", "s2"} <= left:
        left = left - products | {"s"}
    elif "s0*s1*s2" in left:
        left = {d for d in left if d not in products or not {"s0", "s1", "s2"} <= _stretches(d)}
        left |= {"J"}
    return ", ".join(f"{d} > 0" for d in sorted(left)) or "every F"


def _stretches(product: str) -> set[str]:
    return set(re.findall(r"s\d", product))


def _short(x: float) -> str:
    if math.isnan(x):
        return "none"
    return "0" if abs(x) < 1e-12 else f"{x:.3g}"


def rows(
    *names: str, E: float = 1.0, nu: float = 0.49, **keywords: Any
) -> Iterator[dict[str, Any]]:
    """Yield a row for each material; its keys are `COLUMNS`.

    The row of a material that does not accept the parameters has only its name and the reason, as
    ``note``.

    Parameters
    ----------
    *names : str
        The materials; all of `fem_snh.materials()` by default.
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    **keywords : Any
        Shape and tuning parameters.

    Raises
    ------
    BadInput
        If no material accepts the parameters.
    """
    refused: list[BadInput] = []
    chosen = names or materials.names()
    for name in chosen:
        try:
            yield row(name, E, nu, **keywords)
        except BadInput as error:
            refused.append(error)
            if len(refused) == len(chosen):
                raise
            yield dict.fromkeys(COLUMNS, "") | {"name": name, "note": str(error)}


def row(name: str, E: float = 1.0, nu: float = 0.49, **keywords: Any) -> dict[str, Any]:
    """Return one material's row for `rows`; raise BadInput if it refuses the parameters."""
    m = material(name, E, nu, **keywords)
    four = stability.properties(m)
    mu, lam = m.lame
    return (
        {"name": name, "nu": nu, "mu_lame": mu, "lambda_lame": lam}
        | {s.name: s.verdict for s in four}
        | {f"{s.name}_reason": s.reason for s in four}
        | {
            "domain": domain(tuple(map(str, m.expression.domain))),
            "stretches": m.expression.needs_stretches,
            "note": "" if m.expression.has_energy else "no energy",
        }
    )


def write(path: Path, table: list[dict[str, Any]]) -> None:
    """Write the rows as CSV; raise BadInput if ``path`` cannot be written."""
    write_file(path, table_text(COLUMNS, table))
