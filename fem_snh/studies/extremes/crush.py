"""Crush and release: every element pressed to a plane, a line, a point, or turned inside out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import Case, Check, Record, Row, converged, run_of
from fem_snh.studies.extremes.figures import Picture, counts, side_by_side
from fem_snh.studies.pages import markdown

title = "Crush and release"
about = """\
A cube that begins with the same F in every cell, held at three corners by no more than keeps it
somewhere (`fem-snh run crush`), each with and without every node moved at random by up to 1e-6.
With P = mu F + (lam (J - 1) - mu) cof F (the paper's eq. 13, nu >= 0.4) and, with the barrier,
P = mu (1 - 1/(I_C + 1)) F + lam (J - alpha) cof F (eq. 14, nu < 0.4):

- *Plane*, F = diag(1, 1, 0): cof F is the plane's normal, so P pushes along it, by -(mu + lam), or
  -lam alpha, to one side: that of J > 0. The body must be back at rest.
- *Line*, F = diag(1, 0, 0): cof F = 0, so nothing pushes away from the line, and along it mu F (eq.
  14: half of it) pulls the body together: in exact arithmetic it ends as a point. Across the line
  the Hessian has the eigenvalue mu - (mu + lam) < 0, so whatever disturbs it grows. Of eq. 13 the
  energy along the line is a parabola, and Newton's step goes to its least, the point, before
  anything has grown; with the barrier it is a slow quartic, and rounding errors are enough to
  leave: the body must be back at rest, and with eq. 13 at the point.
- *Point*, F = 0: no force. Of eq. 13 the Hessian is mu I, so the point is a minimum, of energy
  (lam - mu) V/2 above rest, and the body must stay, disturbed or not. With the barrier the Hessian
  is 0 and the energy falls to the third order, as -lam alpha J, so the point is no minimum; but the
  force of a disturbance d is of the order lam (d/h)^2, for 1e-6 below the usual tolerances: the run
  says `converged` at once, at a state that is not stable. With a tolerance below that force the
  body must be back at rest.
- *Inverted*, F = -I: P = -2 (mu + lam) I (of eq. 13) pushes it through. Seen as diag(1, 1, -1)
  turned by half, it is nearest to three poses: at rest but turned by half about an axis,
  which these supports allow. It must end with no energy and J = 1 everywhere.

What `converged` means: the residual is small. The lowest eigenfrequency tells a minimum from
another stationary state; the check asks for it."""

#: How far the lowest eigenfrequency [Hz] of a minimum is from zero, for E, density and side 1.
_STIFF = 1e-2
_MODES: dict[str, Any] = {"modes.count": 1, "modes.density": 1.0}
_NOISES = (0.0, 1e-6)
_ELEMENTS = ("Q1", "P1", "Q1P0", "P2P0", "Q2", "P2")
#: With the barrier and without.
_NUS = (0.3, 0.49)


def cases(quick: bool, seeds: int) -> list[Case]:
    """Every element and policy; those with ``trust``, and what no theory says, to be compared."""
    made = [
        _case(element, "adaptive", to, noise, nu)
        for element in (("Q1", "P1") if quick else _ELEMENTS)
        for to in ("plane", "line", "point", "inverted")
        for noise in _NOISES
        for nu in _NUS
    ]
    if not quick:
        made += [
            _case(element, hessian, to, noise, nu, must=hessian != "trust")
            for element in ("Q1", "P1")
            for hessian in ("clamp", "abs", "trust")
            for to in ("plane", "line", "point", "inverted")
            for noise in _NOISES
            for nu in _NUS
        ]
    return made + list(_remedies(quick))


def _case(
    element: str, hessian: str, to: str, noise: float, nu: float, must: bool = True, **more: Any
) -> Case:
    disturbed = "disturbed" if noise else "exact"
    name = f"crush-{element}-{hessian}-{to}-{disturbed}-nu{nu:g}"
    asked, check = _theory(to, nu)
    return run_of(
        "crush", name, asked, check, must=must,
        element=element, hessian=hessian, to=to, noise=noise, nu=nu,
        **_MODES, **more,
    )  # fmt: skip


def _theory(to: str, nu: float) -> tuple[str, Check]:
    """What happens, in words, and whether it did."""
    if to == "point" and nu < 0.4:
        return "stays at the point, which is no minimum", _flat_point
    if to in ("line", "point") and nu >= 0.4:
        return "ends as a point, a minimum", _minimum_point
    return ("at rest, perhaps turned by half", _rest) if to == "inverted" else ("at rest", _rest)


def _remedies(quick: bool) -> Iterator[Case]:
    """What leaves the point and the line."""
    below = {"petsc.snes_scaled_tol": 1e-13}
    tried: dict[str, dict[str, Any]] = {
        "point-tight": {"to": "point", "nu": 0.3, **below},
        "point-barrier": {"to": "point", "nu": 0.49, "material.barrier": True, **below},
        "line-barrier": {"to": "line", "nu": 0.49, "material.barrier": True},
        "line-softened": {"to": "line", "nu": 0.49, "soften": [0.3]},
    }
    for element in ("Q1",) if quick else ("Q1", "P1"):
        for name, values in tried.items():
            yield run_of(
                "crush", f"crush-{element}-{name}", "at rest", _rest,
                element=element, noise=1e-6, **_MODES, **values,
            )  # fmt: skip


def _rest(record: Record, row: Row) -> str:
    """No energy, J = 1 everywhere, and stable: at rest, moved as a rigid body or not."""
    if why := converged(record, row):
        return why
    at_rest = abs(row["energy"]) < 1e-12 and abs(row["min_J"] - 1) < 1e-6
    if at_rest and _frequency(record) > _STIFF:
        return ""
    return (
        f"ends elsewhere: energy {row['energy']:.3g}, min J {row['min_J']:.3g}, "
        f"lowest frequency {_frequency(record):.2g}"
    )


def _flat_point(record: Record, row: Row) -> str:
    """A point that is stationary and no minimum."""
    return _point(record, row) or (
        "it is a minimum" if _frequency(record) > _STIFF else ""
    )  # of a Hessian that is zero: rounding decides the sign


def _minimum_point(record: Record, row: Row) -> str:
    """A point, and a minimum, of the energy (lam - mu) V/2."""
    if why := _point(record, row):
        return why
    mu, lam = (record["material"]["parameters"][key] for key in ("mu", "lam"))
    if not abs(row["energy"] - (lam - mu) / 2) < 1e-9 * lam:
        return f"its energy is {row['energy']:.6g} instead of {(lam - mu) / 2:.6g}"
    return "" if _frequency(record) > _STIFF else "it is no minimum"


def _point(record: Record, row: Row) -> str:
    why = converged(record, row)
    left = abs(row["volume_ratio"]) > 1e-12 or abs(row["min_J"]) > 1e-9
    return why or (f"it left: volume {row['volume_ratio']:.3g}" if left else "")


def _frequency(record: Record) -> float:
    return float(record["modes"]["frequencies"][0])


def tables(rows: pd.DataFrame) -> str:
    """A line for each policy, state, nu and what was asked; remedies one by one."""
    state = rows["point"].str.extract(r"(plane|line|point|inverted)")[0]
    kind = rows["point"].str.extract(r"(exact|disturbed|tight|barrier|softened)")[0]
    groups = rows.assign(state=state, kind=kind).groupby(
        ["state", "kind", "nu", "hessian", "asked"], sort=False
    )
    lines = [
        [at, how, f"{nu:g}", hessian, asked, *counts(mine)]
        for (at, how, nu, hessian, asked), mine in groups
    ]
    head = ["pressed to", "", "nu", "Hessian", "what must happen", *counts.head]
    return markdown(head, lines)


def pictures(out: Path) -> list[Picture]:
    """Where the four begin, and where they end."""
    states = ("plane", "line", "inverted")
    names = [f"crush-Q1-adaptive-{to}-disturbed-nu0.3" for to in states]
    return [
        side_by_side(out, "crush_before.png", names, states, 0.0, "Where they begin."),
        side_by_side(out, "crush_after.png", names, states, 1.0, "Where they end."),
    ]
