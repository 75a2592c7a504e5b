"""Reports of materials: verdicts and the printed text."""

from __future__ import annotations

import csv
from functools import lru_cache
from itertools import permutations

import numpy as np
import pytest
from points import every_name, make

from fem_snh import materials
from fem_snh.errors import BadInput
from fem_snh.kernels.reports import report as tables
from fem_snh.kernels.reports import stability
from fem_snh.kernels.reports.curves import diagonal, inside, stress
from fem_snh.kernels.reports.report import Report
from fem_snh.kernels.reports.stability import Signed

pytestmark = pytest.mark.one_debian


@lru_cache
def reported(name: str, nu: float = 0.3) -> Report:
    return make(name, nu).report()


# --- the other materials -------------------------------------------------------------------------

#: What theory says at nu = 0.3 of inversion, reflection, rest and degeneracy, by name.
VERDICTS = {
    "stable_neo_hookean": ("passed", "passed", "passed", "passed"),
    "stable_fung": ("passed", "passed", "passed", "failed"),  # no origin barrier
    "stable_arruda_boyce": ("passed", "passed", "passed", "failed"),
    "mooney_length": ("passed", "passed", "failed", "failed"),
    "stvk": ("failed", "passed", "passed", "failed"),  # blind to the sign of a stretch
    "corotational": ("failed", "failed", "passed", "failed"),
    "fixed_corotational": ("failed", "failed", "passed", "failed"),
    "arap": ("failed", "failed", "passed", "failed"),  # of I_1, as the corotational ones
    "filtered_neo_hookean": ("failed", "failed", "passed", "failed"),
    "stvk_kikuuwe": ("failed", "passed", "passed", "passed"),  # it resists compression
    "c2_neo_hookean": ("passed", "passed", "passed", "failed"),  # no origin barrier
    "gamma_model": ("passed", "passed", "passed", "failed"),
    "neo_hookean_wang": ("failed", "not applicable", "failed", "not applicable"),
}
#: All others have logarithms or powers of J or of the stretches: they do not exist for J <= 0.
OF_POSITIVE_VOLUMES = ("failed", "not applicable", "passed", "not applicable")


@every_name
def test_verdicts(name):
    r = reported(name)
    found = tuple(s.verdict for s in r.stabilities)
    assert found == VERDICTS.get(name, OF_POSITIVE_VOLUMES)
    assert bool(r.domain) == (r.degeneracy.verdict == "not applicable")
    assert (r.rest.verdict == "passed") == (abs(r.rest_stress) < 1e-9)
    if r.domain:
        assert r.inversion.verdict == "failed" and r.degeneracy.verdict == "not applicable"
    elif "I1" in {str(m) for m in make(name).expression.measures}:
        assert r.reflection.verdict == "failed"
    for s in r.stabilities:
        assert np.isfinite(list(s.numbers.values())).all() or name == "filtered_neo_hookean"


@every_name
def test_signed_stretches_agree_with_the_kernels(name):
    m, signed = make(name), Signed(make(name).expression)
    s = np.array([[1.9, 1.1, 0.4], [1.4, 0.9, 0.55], [2.2, 1.3, -0.45]])
    p = stress(m, s)
    inside = np.isfinite(p[:, 0])
    assert inside[:2].all()
    assert signed.stress(s)[inside] == pytest.approx(p[inside], rel=1e-9, abs=1e-9)
    if m.expression.has_energy:
        assert signed.energy(s)[inside] == pytest.approx(m.energy(diagonal(s))[inside], rel=1e-9)
        assert np.isnan(signed.energy(s)[~inside]).all()


@every_name
def test_kernels_take_any_order_and_pair_of_signs(name):
    """F = diag(s) with its stretches permuted and two signs turned is the same element turned."""
    m = make(name)
    s = np.array([1.9, 1.1, 0.4]) * np.concatenate([stability.FLIPS, -stability.FLIPS])
    for versions in (s[:4], s[4:]):  # inverted, upright
        F = diagonal(versions[:, list(permutations(range(3)))].reshape(-1, 3))
        if not inside(m, F[0]):
            assert not inside(m, F).any()
            continue
        if m.expression.has_energy:
            assert m.energy(F) == pytest.approx(m.energy(F)[0], rel=1e-12)
        values = np.sort(m.eigensystem(F)[0], axis=-1)
        assert values == pytest.approx(np.tile(values[0], (len(F), 1)), rel=1e-8, abs=1e-9)


# --- the whole -----------------------------------------------------------------------------------


def test_table(tmp_path, monkeypatch):
    some = ["neo_hookean", "stable_neo_hookean", "fixed_corotational"]
    monkeypatch.setattr(materials, "names", lambda: sorted(some))
    found = list(tables.rows(E=2.0, nu=0.3))
    assert [r["name"] for r in found] == sorted(some)
    assert all(tuple(sorted(r)) == tuple(sorted(tables.COLUMNS)) for r in found)
    tables.write(tmp_path / "new" / "t.csv", found)
    with (tmp_path / "new" / "t.csv").open(newline="") as file:
        back = list(csv.DictReader(file))
    assert [r["inversion"] for r in back] == ["failed", "failed", "passed"]
    assert float(back[0]["mu_lame"]) == pytest.approx(2 / 2.6)
    with pytest.raises(BadInput, match=r"nu = 0\.7"):
        list(tables.rows(nu=0.7))
    with pytest.raises(BadInput, match="cannot write"):
        tables.write(tmp_path, found)
