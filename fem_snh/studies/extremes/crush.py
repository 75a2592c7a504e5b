"""The family "crush": bodies released from a plane, a line, a point, or an inverted state."""

from __future__ import annotations

from itertools import product
from typing import Any

from fem_snh.studies.extremes.cases import POLICIES, Case, Check, Record, Row, converged, scene_case

LABEL = "-((?:plane|line|point|inverted)-.*?)(?:-nu.*)?$"
BY = ("nu", "hessian", "globalization", "criterion")
PICTURES = {
    "crush.png": (
        "Collapsed to a plane, to a line, inverted; below: released.",
        [
            (f"crush-Q1-adaptive-{to}-disturbed-nu0.3", load, f"{to}{after}")
            for load, after in ((0.0, ""), (1.0, ", released"))
            for to in ("plane", "line", "inverted")
        ],
    )
}
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


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
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
        criterion, check = ("at rest", _rest) if material else _theory(to, noise, nu)
        made.append(
            scene_case(
                "crush", f"crush-{element}-{policy}-{to}-{disturbed}-nu{nu:g}", criterion, check,
                material, required,
                element=element, to=to, noise=noise, nu=nu, **POLICIES[policy], **_MODES,
            )
        )  # fmt: skip
    for element, (name, values) in product([] if material else elements, _SETTINGS.items()):
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
