"""The family "crush": bodies released from a plane, a line, a point, or an inverted state.

A cube starts with the same F in every cell, its rigid motions removed by constraints at three
corners (`fem-snh run crush`), exactly and with every node moved at random by up to 1e-6. The stress
is P = mu F + (lam (J - 1) - mu) cof F (Smith et al. 2018, eq. 13, nu >= 0.4), and with the barrier
P = mu (1 - 1/(I_C + 1)) F + lam (J - alpha) cof F (eq. 14, nu < 0.4).

- *Plane*, F = diag(1, 1, 0): cof F is normal to the plane. P acts along it, by -(mu + lam) or
  -lam alpha, towards J > 0. The body must return to rest.
- *Line*, F = diag(1, 0, 0): cof F = 0, so no stress acts across the line. Along it mu F (eq. 14:
  half of it) contracts the body: in exact arithmetic it ends as a point. Across the line the
  Hessian has the eigenvalue mu - (mu + lam) < 0, so disturbances grow. The energy of eq. 13 along
  the line is a parabola, and Newton's step reaches its minimum, the point, before a disturbance has
  grown. With the barrier it is a quartic, on which Newton's method is slow: a disturbed body must
  return to rest, and for an exact one rounding errors suffice, except with `abs`, which keeps it on
  the line. With the barrier at nu = 0.49 it must leave the line; each part may leave in its own
  direction, so that folds may remain. Started at nu = 0.3 (`nu_continuation`) it must return to
  rest.
- *Point*, F = 0: no stress. The Hessian of eq. 13 is mu I, so the point is a minimum, of energy
  (lam - mu) V/2 above rest, and the body must stay there, disturbed or not. With the barrier the
  Hessian is 0 and the energy decreases to third order, as -lam alpha J, so the point is no minimum;
  but the force of a disturbance d is of the order lam (d/h)^2, which for 1e-6 is below the default
  tolerances: the run converges without a step, to an unstable state. With a tolerance below that
  force the body must return to rest at nu = 0.3; at 0.49 it must leave the point and, started at
  nu = 0.3, return to rest, as from the line.
- *Inverted*, F = -I: P = -2 (mu + lam) I (eq. 13) acts towards inversion back. F is diag(1, 1, -1)
  rotated by pi, and three poses are equally near: rest rotated by pi about an axis, which these
  constraints allow. Parts of the body may choose different ones, and without the barrier the result
  may be a minimum. At nu = 0.49 only runs that start at nu = 0.3 (`nu_continuation`) are expected
  to pass: they end with zero energy and J = 1 everywhere. Those without continuation may fail.

`converged` means that the residual is small. The lowest eigenfrequency distinguishes a minimum from
another stationary state; the criteria use it.
"""

from __future__ import annotations

from itertools import product
from typing import Any

from benchmarks.extremes.cases import POLICIES, Case, Check, Record, Row, converged, scene_case

#: Lowest eigenfrequency [Hz] from which a state counts as a minimum, for E = density = side = 1.
_MINIMUM_FREQUENCY = 1e-2
_MODES: dict[str, Any] = {"modes.count": 1, "modes.density": 1.0}
_STATES = ("plane", "line", "point", "inverted")
_NOISES = (0.0, 1e-6)
_ELEMENTS = ("Q1", "P1", "Q1P0", "P2P0", "Q2", "P2")
_NUS = (0.3, 0.49)
#: The material has the barrier term below this nu (Smith et al. 2018, appendix D).
BARRIER_NU = 0.4


#: The settings with which the body leaves the point, the line and the inverted state.
_TIGHT = {"petsc.snes_scaled_tol": 1e-13}
_BY_BARRIER: dict[str, Any] = {"nu": 0.49, "material.barrier": True}
_BY_CONTINUATION: dict[str, Any] = {"nu": 0.49, "nu_continuation": [0.3]}
_SETTINGS: dict[str, dict[str, Any]] = {
    "point-tight": {"to": "point", "nu": 0.3, **_TIGHT},
    "point-barrier": {"to": "point", **_BY_BARRIER, **_TIGHT},
    "point-continuation": {"to": "point", **_BY_CONTINUATION, **_TIGHT},
    "line-barrier": {"to": "line", **_BY_BARRIER},
    "line-continuation": {"to": "line", **_BY_CONTINUATION},
    "inverted-continuation": {"to": "inverted", **_BY_CONTINUATION},
    "inverted-continuation-exact": {"to": "inverted", **_BY_CONTINUATION, "noise": 0.0},
}


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases of every element and policy; those of the trust region may fail."""
    elements = _ELEMENTS[: 1 if quick else None]
    pairs = [(element, "adaptive") for element in elements]
    if not quick:
        pairs += product(("Q1", "P1"), ("clamp", "abs", "trust"))
    noises = _NOISES[1 if quick else 0 :]
    made = []
    for (element, policy), to, noise, nu in product(pairs, _STATES, noises, _NUS):
        disturbed = "disturbed" if noise else "exact"
        required = policy != "trust" and (to != "inverted" or nu < BARRIER_NU)
        criterion, check = _theory(to, noise, nu)
        made.append(
            scene_case(
                "crush", f"crush-{element}-{policy}-{to}-{disturbed}-nu{nu:g}", criterion, check,
                required,
                element=element, to=to, noise=noise, nu=nu, **POLICIES[policy], **_MODES,
            )
        )  # fmt: skip
    for element, (name, values) in product(elements, _SETTINGS.items()):
        folds = name.endswith("barrier")  # each part may leave in its own direction
        criterion, check = ("leaves it", _left_the_state) if folds else ("at rest", _rest)
        given = {"element": element, "noise": 1e-6, **_MODES, **values}
        made.append(scene_case("crush", f"crush-{element}-{name}", criterion, check, **given))
    return made


def _theory(to: str, noise: float, nu: float) -> tuple[str, Check]:
    """Return the state that theory predicts, in words and as a check."""
    if to == "line" and nu < BARRIER_NU and not noise:
        return "at rest, or ends as a point, no minimum", _rest_or_point
    if to == "point" and nu < BARRIER_NU:
        return "stays at the point, no minimum", _unstable_point
    if to in ("line", "point") and nu >= BARRIER_NU:
        return "ends as a point, a minimum", _minimum_point
    return ("at rest, perhaps rotated by pi" if to == "inverted" else "at rest"), _rest


def _rest(record: Record, row: Row) -> str:
    """Check for zero energy, J = 1 and stability: at rest, up to a rigid motion."""
    if reason := converged(record, row):
        return reason
    at_rest = abs(row["energy"]) < 1e-12 and abs(row["min_J"] - 1) < 1e-6
    if at_rest and _frequency(record) > _MINIMUM_FREQUENCY:
        return ""
    return (
        f"ends elsewhere: energy {row['energy']:.3g}, min J {row['min_J']:.3g}, "
        f"lowest frequency {_frequency(record):.2g}"
    )


def _unstable_point(record: Record, row: Row) -> str:
    """Check for a point that is stationary and no minimum."""
    # Its Hessian is zero, so rounding decides the sign of the frequency.
    minimum = _frequency(record) > _MINIMUM_FREQUENCY
    return _point(record, row) or ("it is a minimum" if minimum else "")


def _left_the_state(record: Record, row: Row) -> str:
    """Check for a minimum whose volume is about that at rest."""
    if reason := converged(record, row):
        return reason
    if abs(row["volume_ratio"] - 1) < 0.1 and _frequency(record) > _MINIMUM_FREQUENCY:
        return ""
    return f"volume {row['volume_ratio']:.3g}, lowest frequency {_frequency(record):.2g}"


def _rest_or_point(record: Record, row: Row) -> str:
    """Check for rest (by rounding errors) or an unstable point (in exact arithmetic)."""
    reason = _rest(record, row)
    return reason and _unstable_point(record, row) and reason


def _minimum_point(record: Record, row: Row) -> str:
    """Check for a point that is a minimum, of the energy (lam - mu) V/2."""
    if reason := _point(record, row):
        return reason
    mu, lam = (record["material"]["parameters"][key] for key in ("mu", "lam"))
    if not abs(row["energy"] - (lam - mu) / 2) < 1e-9 * lam:
        return f"its energy is {row['energy']:.6g} instead of {(lam - mu) / 2:.6g}"
    return "" if _frequency(record) > _MINIMUM_FREQUENCY else "it is no minimum"


def _point(record: Record, row: Row) -> str:
    """Check that the body is a point."""
    reason = converged(record, row)
    left = abs(row["volume_ratio"]) > 1e-12 or abs(row["min_J"]) > 1e-9
    return reason or (f"it left: volume {row['volume_ratio']:.3g}" if left else "")


def _frequency(record: Record) -> float:
    """Return the lowest eigenfrequency [Hz]; negative for an unstable mode."""
    return float(record["modes"]["frequencies"][0])
