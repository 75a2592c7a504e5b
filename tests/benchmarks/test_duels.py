"""Duels: the scenes are what they say, and a program or its absence makes a row."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import duels
from benchmarks.duels import scenes
from benchmarks.duels.scenes import SCENES

pytestmark = pytest.mark.one_debian


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("degree", [1, 2])
def test_cells_are_not_inverted(name: str, degree: int) -> None:
    x, cells = SCENES[name].mesh(3, degree)
    assert len(np.unique(cells)) == len(x)
    edges = x[cells[:, [1, 3, 4]]] - x[cells[:, [0]]]
    assert (np.linalg.det(edges) > 0).all()


@pytest.mark.parametrize(("name", "total"), [("bar", (0, 0, -9810 * 0.04)), ("cook", (0, 100, 0))])
@pytest.mark.parametrize("degree", [1, 2])
def test_loads_have_the_total_of_the_scene(
    name: str, total: tuple[float, ...], degree: int
) -> None:
    x, cells = SCENES[name].mesh(2, degree)
    np.testing.assert_allclose(SCENES[name].loads(x, cells).sum(axis=0), total, atol=1e-9)


def test_forces_of_an_error_are_its_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def solve(*_: object) -> dict[str, object]:
        raise ArithmeticError("no convergence")

    monkeypatch.setattr(sys, "argv", ["program", "bar", "1", "2"])
    scenes.main(solve)
    assert '"number": null, "status": "ArithmeticError: no convergence"' in capsys.readouterr().out


def test_a_row_of_this_program() -> None:
    bar, none = [
        *duels.rows(peers="fem_snh", scenes="bar"),
        *duels.rows(peers="fem_snh --accuracy", scenes="inverted"),
    ]
    assert bar["within"]
    assert bar["status"] == "converged"
    assert none["status"].startswith("none")


def test_a_peer_that_cannot_be_installed_says_why(tmp_path: Path) -> None:
    peer = duels.Peer(("./no_such_package",), {})
    python, reason = duels.environment("nobody", peer, tmp_path)
    assert not python
    assert "cannot be installed: ERROR" in reason
