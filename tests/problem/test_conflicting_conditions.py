"""Conditions on groups by name and by number, at common nodes."""

from __future__ import annotations

from typing import Any

import pytest
from gmsh_files import BOX, write_msh
from running import solve

from fem_snh.errors import BadInput
from fem_snh.scenes import Hold, MaterialChoice, Move, Probe, Scene

pytestmark = pytest.mark.mpi


@pytest.fixture
def box(comm: Any, folder: Any) -> Any:
    return write_msh(comm, folder, BOX.replace("RECOMBINE", "Recombine;"))


def scene(box: Any, **tables: Any) -> Scene:
    material = MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3)
    return Scene(name="box", mesh=box, element="Q1", material=material, **tables)


def message(made: Scene) -> str:
    with pytest.raises(BadInput) as caught:
        solve(made)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_one_group_by_name_and_by_number(box: Any) -> None:
    """The nodes decide, not the words; different components, and equal values, are fine."""
    moved = Move(group="surface:start", translate=(0.1, 0, 0))
    expected = "components other than x, y, z, which [[hold]] of 'start' constrains at the same"
    found = message(scene(box, hold=[Hold(group="start")], move=[moved]))
    assert f"move.group = 'surface:start': expected {expected}" in found
    twice = [Move(group="start", translate=(0.1, 0, 0)), Move(group=20, translate=(0.2, 0, 0))]
    assert "[[move]] of 'start' constrains at the same nodes" in message(scene(box, move=twice))
    held = Hold(group="start", components=("y", "z"))
    pulled = Move(group="surface:start", translate=(0.1, 0, 0), components=("x",))
    assert solve(scene(box, hold=[held], move=[pulled])).converged
    equal = Move(group=20, translate=(0, 0, 0))
    assert solve(scene(box, hold=[Hold(group="start")], move=[equal])).converged


def test_a_common_edge_belongs_to_the_later_condition(box: Any) -> None:
    moved = Move(group="edge", translate=(0.1, 0, 0))
    corners = [Probe(name="on", point=(0, 0, 0)), Probe(name="off", point=(0, 0, 1))]
    result = solve(scene(box, hold=[Hold(group="start")], move=[moved], probe=corners))
    found = result.steps[-1]["probes"]
    assert result.converged
    assert found["on"] == pytest.approx([0.1, 0, 0], abs=1e-12)
    assert found["off"] == pytest.approx([0, 0, 0], abs=1e-12)
    (note,) = [note for note in result.notes if note["kind"] == "load"]
    words = "[[hold]] of 'start' and [[move]] of 'edge' prescribe other values of x at "
    assert note["text"].startswith(words)
    assert "common nodes, one at (0, 0, 0), where [[move]] of 'edge' is taken" in note["text"]
    roller = Hold(group="start", components=("y", "z"))
    result = solve(scene(box, hold=[roller], move=[moved]))
    assert result.converged and not [note for note in result.notes if note["kind"] == "load"]
