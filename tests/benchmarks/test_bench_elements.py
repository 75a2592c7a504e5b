"""The measurements of docs/results/elements.md, small: what they say of an element."""

from __future__ import annotations

import json

import pytest

import benchmarks
from benchmarks import (
    convergence_orders,
    hessian_filters,
    negative_curvature,
    quadrature,
    taylor_hood,
    two_dimensions,
    volume_split,
)
from fem_snh.assembly.elements import ELEMENTS

pytestmark = pytest.mark.one_debian


def test_orders() -> None:
    (locked, free) = convergence_orders.rows(elements="P1,P2P1", nus="0.4999", cells="2,4")
    assert locked["cells"] == free["cells"] == [2, 4] and locked["ok"] and free["ok"]
    assert locked["orders"]["H1"][0] < 0.7 and "pressure" not in locked
    assert free["orders"]["H1"][0] > 1.7 and free["orders"]["pressure"][0] > 1.7


def test_orders_at_one_half_are_of_elements_with_a_pressure() -> None:
    found = [row["element"] for row in convergence_orders.rows(nus="0.5", cells="2")]
    assert found == [e.name for e in ELEMENTS.values() if e.volume == "pressure"]


def test_quadrature() -> None:
    rows = list(quadrature.rows(elements="Q1P0", nus="0.3", cells=2, repeat=1))
    assert [row["points"] for row in rows] == [8, 27]
    assert [row["default"] for row in rows] == [True, False]
    assert [row["spurious"] for row in rows] == [0, 0] and all(row["ok"] for row in rows)
    assert max(row["volume_error"] for row in rows) < 1e-13
    assert rows[0]["error"][0.3] == pytest.approx(rows[1]["error"][0.3], rel=1e-3)
    assert all(row["cost"] > 0 for row in rows)


def test_bound_keeps_taylor_hood_cells_from_collapsing() -> None:
    none, some = volume_split.rows(elements="Q2Q1", bounds="0,2", stretches="1,0.5", cells=2)
    assert none["least"]["0.5"] < 0 < some["least"]["0.5"]
    assert none["spurious"] == some["spurious"] == 0
    assert some["converged"] and len(some["newton"]) == 2 and some["min_J"][1] > 0.7


def test_bound_is_put_back(capsys: pytest.CaptureFixture[str]) -> None:
    with volume_split.split_at(0.0), volume_split.split_at(1.0):
        pass
    assert benchmarks.main("volume_split", {"elements": "Q1", "stretches": "1", "cells": 2}) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["bound"] is None and row["least"]["1"] > 0


def test_filters_reach_one_state_from_rough_starts() -> None:
    (row,) = hessian_filters.rows(elements="Q2Q1", cases="twist", nus="0.49", cells="2", seeds=2)
    assert row["failed"] == {"clamp": 0, "abs": 0, "adaptive": 0} and row["states"] == 1
    assert row["newton"]["adaptive"] < row["newton"]["clamp"] < row["newton"]["abs"]
    assert row["better"] == 0


def test_filters_count_what_is_given_up() -> None:
    (row,) = hessian_filters.rows(
        elements="Q2", cases="press", nus="0.4999", cells="2", seeds=1, hessians="abs"
    )
    assert row["newton"] == {"abs": None} and row["failed"] == {"abs": 1} and row["states"] == 0


def test_policies_on_loads_in_one_step() -> None:
    found = list(
        negative_curvature.rows(
            cases="quarter turn", cells="3", hessians="ratio,abs,adaptive+trust_region", seeds=2
        )
    )
    assert [(row["hessian"], row["allowed"]) for row in found] == [
        (hessian, allowed) for hessian in ("ratio", "abs", "adaptive") for allowed in (0, 20)
    ]
    assert all(len(row["newton"]) == 2 and all(row["newton"]) for row in found)
    assert len({energy for row in found for energy in row["energy"]}) == 1
    assert not any(sum(row["lbfgs"]) for row in found if row["allowed"] == 0)


@pytest.mark.parametrize("element", ["P2P1", "Q2Q1"])
def test_linear_iterations_hardly_grow_with_nu(
    element: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(taylor_hood.SCENES, "block", ([4], {"steps": 1}))
    (row,) = taylor_hood.rows(elements=element, scenes="block", nus="0.3,0.5", tolerance=1e-6)
    assert row["ok"] and 1 < row["growth"] <= 2
    assert row["growth"] == pytest.approx(row["linear"]["0.5"] / row["linear"]["0.3"], abs=0.006)


def test_sections_of_the_bushing_and_the_tube(monkeypatch):
    """The parts that are asked for, to the finest mesh; with at most two cells in a wall."""
    solved = two_dimensions.solved
    monkeypatch.setattr(
        two_dimensions,
        "solved",
        lambda scene, cells, **keys: solved(scene, cells=min(cells, 2), **keys),
    )
    rows = list(two_dimensions.rows(parts="tube,bushing", finest=2))
    assert [row["cells"] for row in rows] == [2, 2, 1, 2, 1, 2, 4]
    assert max(row["error"] for row in rows[:2]) < 1e-3
