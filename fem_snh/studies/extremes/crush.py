"""Crush and release: every element pressed to a plane, a line, a point, or turned inside out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import Case, Check, Record, Row, converged, run_of
from fem_snh.studies.extremes.pictures import Picture, bodies, counts
from fem_snh.studies.markdown import markdown

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
  anything has grown. With the barrier it is a slow quartic: a disturbed body must be back at rest,
  and for an exact one rounding errors are enough, but with `abs`, which keeps it on the line. With
  the barrier at nu = 0.49 it must leave, though each part its own way, so that kinks may stay; by
  way of nu = 0.3 (`nu_continuation`) it must be back at rest.
- *Point*, F = 0: no force. Of eq. 13 the Hessian is mu I, so the point is a minimum, of energy
  (lam - mu) V/2 above rest, and the body must stay, disturbed or not. With the barrier the Hessian
  is 0 and the energy falls to the third order, as -lam alpha J, so the point is no minimum; but the
  force of a disturbance d is of the order lam (d/h)^2, for 1e-6 below the usual tolerances: the run
  says `converged` at once, at a state that is not stable. With a tolerance below that force the
  body must be back at rest at nu = 0.3; at 0.49 it must leave, and by way of 0.3 be back, as from
  the line.
- *Inverted*, F = -I: P = -2 (mu + lam) I (of eq. 13) pushes it through. Seen as diag(1, 1, -1)
  turned by half, it is nearest to three poses: at rest but turned by half about an axis, which
  these supports allow. Parts of the body may choose different ones, and without the barrier that
  may be a minimum. So what must hold at nu = 0.49 is asked of runs that begin with nu = 0.3
  (`nu_continuation`): they end with no energy and J = 1 everywhere. The plain ones are there to be
  compared.

What `converged` means: the residual is small. The lowest eigenfrequency tells a minimum from
another stationary state; the check asks for it."""

#: How far the lowest eigenfrequency [Hz] of a minimum is from zero, for E, density and side 1.
_STIFF = 1e-2
_MODES: dict[str, Any] = {"modes.count": 1, "modes.density": 1.0}
_NOISES = (0.0, 1e-6)
_ELEMENTS = ("Q1", "P1", "Q1P0", "P2P0", "Q2", "P2")
#: With the barrier and without: the material leaves it out from here on.
_NUS, BARRIER = (0.3, 0.49), 0.4


def cases(quick: bool, seeds: int) -> list[Case]:
    """Every element and policy; those of ``trust``, and what no theory says, to be compared."""
    tried = [(element, "adaptive") for element in (("Q1",) if quick else _ELEMENTS)]
    if not quick:
        tried += [(e, hessian) for e in ("Q1", "P1") for hessian in ("clamp", "abs", "trust")]
    made = []
    for element, hessian in tried:
        for to in ("plane", "line", "point", "inverted"):
            for noise in (1e-6,) if quick else _NOISES:
                for nu in _NUS:
                    sure = hessian != "trust" and (to != "inverted" or nu < BARRIER)
                    made.append(_case(element, hessian, to, noise, nu, must=sure))
    return made + list(_remedies(("Q1",) if quick else _ELEMENTS))


def _case(element: str, hessian: str, to: str, noise: float, nu: float, must: bool) -> Case:
    disturbed = "disturbed" if noise else "exact"
    name = f"crush-{element}-{hessian}-{to}-{disturbed}-nu{nu:g}"
    asked, check = _theory(to, noise, nu)
    return run_of(
        "crush", name, asked, check, must=must,
        element=element, hessian=hessian, to=to, noise=noise, nu=nu, **_MODES,
    )  # fmt: skip


def _theory(to: str, noise: float, nu: float) -> tuple[str, Check]:
    """What happens, in words, and whether it did."""
    if to == "line" and nu < BARRIER and not noise:
        return "at rest, or ends as a point, no minimum", _rest_or_point
    if to == "point" and nu < BARRIER:
        return "stays at the point, no minimum", _flat_point
    if to in ("line", "point") and nu >= BARRIER:
        return "ends as a point, a minimum", _minimum_point
    return ("at rest, perhaps turned by half", _rest) if to == "inverted" else ("at rest", _rest)


def _remedies(elements: Sequence[str]) -> Iterator[Case]:
    """What leaves the point and the line, and leads an inverted body home."""
    below = {"petsc.snes_scaled_tol": 1e-13}
    tried: dict[str, dict[str, Any]] = {
        "point-tight": {"to": "point", "nu": 0.3, **below},
        "point-barrier": {"to": "point", "nu": 0.49, "material.barrier": True, **below},
        "point-softened": {"to": "point", "nu": 0.49, "nu_continuation": [0.3], **below},
        "line-barrier": {"to": "line", "nu": 0.49, "material.barrier": True},
        "line-softened": {"to": "line", "nu": 0.49, "nu_continuation": [0.3]},
        "inverted-softened": {"to": "inverted", "nu": 0.49, "nu_continuation": [0.3]},
        "inverted-softened-exact": {
            "to": "inverted",
            "nu": 0.49,
            "nu_continuation": [0.3],
            "noise": 0.0,
        },
    }
    for element in elements:
        for name, values in tried.items():
            given = {"element": element, "noise": 1e-6, **_MODES, **values}
            kinks = name.endswith("barrier")  # each part may leave its own way
            asked, check = ("leaves, for good", _leaves) if kinks else ("at rest", _rest)
            yield run_of("crush", f"crush-{element}-{name}", asked, check, **given)


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


def _leaves(record: Record, row: Row) -> str:
    """A minimum of about the volume at rest."""
    if why := converged(record, row):
        return why
    if abs(row["volume_ratio"] - 1) < 0.1 and _frequency(record) > _STIFF:
        return ""
    return f"volume {row['volume_ratio']:.3g}, lowest frequency {_frequency(record):.2g}"


def _rest_or_point(record: Record, row: Row) -> str:
    """What rounding, or exact arithmetic, makes of the line."""
    why = _rest(record, row)
    return why and _flat_point(record, row) and why


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
    """Where they begin, and where they end."""
    panels = [
        (f"crush-Q1-adaptive-{to}-disturbed-nu0.3", load, f"{to}{after}")
        for load, after in ((0.0, ""), (1.0, ", released"))
        for to in ("plane", "line", "inverted")
    ]
    caption = "Pressed flat, to a line, turned inside out; below: let go."
    return [bodies(out, "crush.png", panels, caption)]
