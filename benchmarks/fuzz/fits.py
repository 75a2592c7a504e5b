"""Files of test data with the stresses of a known material, which a fit finds again."""

from __future__ import annotations

import json
import math
from pathlib import Path
from random import Random

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import write
from fem_snh.records.units import STRESS_UNITS

#: The largest stretch, and the exponents n, m of P = 2 (x - x^-n) (W1 + x^m W2) at volume 1, where
#: W1 and W2 are the derivatives of the energy by its invariants.
_TESTS = {"uniaxial": (4.0, 2, -1), "equibiaxial": (2.5, 5, 2), "planar": (3.0, 3, 0)}
_HEADS = {"stretch": (0.0, 1.0), "strain": (1.0, 1.0), "strain [%]": (1.0, 100.0)}


def make_fit(random: Random, folder: Path) -> list[str]:
    """Test data of a random material, in any unit, column, order of lines and separator"""
    test = random.choice(list(_TESTS))
    largest, n, m = _TESTS[test]
    mu, ratio = 10 ** random.uniform(3, 8), random.uniform(0.1, 0.9)
    name = random.choice(("neo_hookean", "mooney_rivlin", "yeoh", "gent"))
    if (name, test) == ("mooney_rivlin", "planar"):  # it shows the sum of the constants alone
        name = "neo_hookean"
    known = {
        "neo_hookean": {},
        "mooney_rivlin": {"C1": mu / 2 * ratio},
        "yeoh": {"C20": 0.01 * ratio * mu, "C30": 0.001 * ratio * mu},
        "gent": {"J_m": 20 + 80 * ratio},
    }[name]
    unit, head, separator = (random.choice(list(x)) for x in (STRESS_UNITS, _HEADS, ",;\t"))
    rest, size = _HEADS[head]
    rows = []
    for i in range(12):
        x = 1 + (largest - 1) * (i + random.uniform(0.2, 1)) / 12
        invariant = (x**2 + 2 / x, 2 * x**2 + x**-4, x**2 + 1 + x**-2)[list(_TESTS).index(test)]
        W1, W2 = mu / 2, 0.0
        if name == "mooney_rivlin":
            W1, W2 = known["C1"], mu / 2 - known["C1"]
        elif name == "yeoh":
            W1 += 2 * known["C20"] * (invariant - 3) + 3 * known["C30"] * (invariant - 3) ** 2
        elif name == "gent":
            W1 /= 1 - (invariant - 3) / known["J_m"]
        stress = 2 * (x - x**-n) * (W1 + x**m * W2) / STRESS_UNITS[unit]
        rows.append((repr((x - rest) * size), repr(stress), "1"))
    for _ in range(random.choice((0, 0, 3))):  # points that do not count
        rows.append((repr(size * random.uniform(0.5, 2)), repr(random.uniform(-1, 1)), "0"))
    random.shuffle(rows)
    lines = [f"# test = {test}", separator.join((head, f"stress [{unit}]", "weight"))]
    lines += map(separator.join, rows)
    state = write(random, folder / "data.csv", "\n".join([*lines, ""]).encode())
    return [state, name, json.dumps({"E": 3 * mu} | known)]


def _fit(arguments: list[str]) -> int:
    """Fit; a whole file gives its constants, and every file the same ones in another unit."""
    import fem_snh

    state, name, known = arguments[0], arguments[1], json.loads(arguments[2])
    found, other = (fem_snh.fit(name, "data.csv", modulus_unit=u) for u in (None, "MPa"))
    assert all(map(math.isfinite, (*found.parameters.values(), found.rms)))
    assert not any(error < 0 for error in found.errors.values())
    if found.units["E"]:
        assert math.isclose(found.E, 1e6 * other.E, rel_tol=1e-6), (found, other)
    if state == "whole":
        for key, value in known.items():
            assert math.isclose(found.parameters[key], value, rel_tol=1e-4), (found, known)
    return 0


FAMILIES = {"fit": Family(make_fit, _fit, ("fem_snh.studies.fit",))}
