"""Published numbers: a quick subset of `python -m benchmarks references`, each within its limit."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache

from mpi4py import MPI

import pytest

from benchmarks import Row
from benchmarks.references.block import block
from benchmarks.references.cook import cook, cook_locking, cook_locking_free
from benchmarks.references.exact import plane_strain, torsion, uniaxial

pytestmark = pytest.mark.one_debian

mpi = pytest.mark.mpi


@cache
def small_block() -> list[Row]:
    """The block on its coarsest mesh. Collective."""
    return list(block(finest=4))


@cache
def small_torsion(element: str) -> list[Row]:
    """The torque and the force of two materials on a coarse mesh. Collective."""
    return list(torsion(element, cells=4))


@cache
def every_uniaxial() -> list[Row]:
    """The bar of all elements. Collective."""
    return list(uniaxial())


QUICK: dict[str, Callable[[], Iterable[Row]]] = {
    "cook": lambda: cook(finest=8),
    "cook_locking": lambda: cook_locking(finest=10),
    "cook_locking_free": lambda: cook_locking_free(finest=16),
    "block": small_block,
    "plane_strain": plane_strain,
    "torsion": lambda: small_torsion("Q2Q1"),
}


@pytest.mark.parametrize("name", QUICK)
def test_ours_are_as_published(name: str) -> None:
    found = list(QUICK[name]())
    assert any(row["limit"] for row in found) and all(row["ok"] for row in found), found


def test_incompressible_uniaxial_is_exact() -> None:
    found = every_uniaxial()
    assert len(found) == 12 and all(row["ok"] for row in found), found


@mpi
def test_the_block_sinks_as_far_on_any_number_of_ranks(comm: MPI.Comm) -> None:
    """Digits of one rank, as printed by `bench references --only block`."""
    ours = {(row["what"], row["source"][-3:]): row["ours"] for row in small_block()}
    assert ours["-u_z (0, 0, 50) [mm], Q1P0, 4 x 4 x 4", "3.3"] == pytest.approx(19.8163, rel=1e-5)


@mpi
@pytest.mark.parametrize("element", ["P2P1", "Q2Q1"])
def test_rivlins_cylinder_on_any_number_of_ranks(comm: MPI.Comm, element: str) -> None:
    """Coarse: the torque within 3 %, and the ends pressed together, more for Mooney-Rivlin."""
    torque, force, other_torque, other_force = small_torsion(element)
    assert abs(torque["difference"]) < 3 and abs(other_torque["difference"]) < 3
    assert other_force["ours"] < force["ours"] < 0
