"""Groups by name and by number, in part inside of the body, and two cavities on one surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gmsh_files import BOX, write_msh

import fem_snh
from fem_snh.errors import BadInput
from fem_snh.scenes import (
    Cavity,
    Geometry,
    Hold,
    MaterialChoice,
    Move,
    Pressure,
    Probe,
    Scene,
    Traction,
)

pytestmark = pytest.mark.mpi


@pytest.fixture
def box(comm: Any, folder: Any) -> Any:
    return write_msh(comm, folder, BOX.replace("RECOMBINE", "Recombine;"))


def scene(box: Any, **tables: Any) -> Scene:
    material = MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3)
    return Scene(name="box", mesh=box, element="Q1", material=material, **tables)


def message(made: Scene) -> str:
    with pytest.raises(BadInput) as caught:
        fem_snh.run(made, progress=False)
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
    assert fem_snh.run(scene(box, hold=[held], move=[pulled]), progress=False).converged
    equal = Move(group=20, translate=(0, 0, 0))
    assert fem_snh.run(
        scene(box, hold=[Hold(group="start")], move=[equal]), progress=False
    ).converged


def test_a_common_edge_belongs_to_the_later_condition(box: Any) -> None:
    moved = Move(group="edge", translate=(0.1, 0, 0))
    corners = [Probe(name="on", point=(0, 0, 0)), Probe(name="off", point=(0, 0, 1))]
    result = fem_snh.run(
        scene(box, hold=[Hold(group="start")], move=[moved], probe=corners), progress=False
    )
    found = result.steps[-1]["probes"]
    assert result.converged
    assert found["on"] == pytest.approx([0.1, 0, 0], abs=1e-12)
    assert found["off"] == pytest.approx([0, 0, 0], abs=1e-12)
    (note,) = [note for note in result.notes if note["kind"] == "load"]
    assert note["text"].startswith(
        "[[hold]] of 'start' and [[move]] of 'edge' prescribe other values of x at "
    )
    assert "common nodes, one at (0, 0, 0), where [[move]] of 'edge' is taken" in note["text"]
    roller = Hold(group="start", components=("y", "z"))
    result = fem_snh.run(scene(box, hold=[roller], move=[moved]), progress=False)
    assert result.converged and not [note for note in result.notes if note["kind"] == "load"]


@pytest.mark.parametrize("table", ["traction", "pressure"])
def test_a_load_inside_of_the_body(box: Any, table: str) -> None:
    """An integral over the boundary leaves it out: it used to converge in 0 iterations."""
    kinds = {
        "traction": lambda key: Traction(group=key, vector=(1, 0, 0)),
        "pressure": lambda key: Pressure(group=key, value=1.0),
    }
    made = scene(box, hold=[Hold(group="start")], **{table: [kinds[table]("middle")]})
    expected = "expected a surface of the body; 4 of its 4 facets are inside of it"
    assert f"{table}.group = 'middle': {expected}" in message(made)


def shell(*fluids: Cavity) -> Scene:
    """An octant of a hollow ball of the radii 1 and 1.5: the cavity has the volume pi/6."""
    return Scene(
        name="shell",
        mesh=Geometry(source="shell", parameters={"layers": 1, "outer": 1.5}),
        cells=2,
        element="Q2",
        material=MaterialChoice(name="stable_neo_hookean", E=3.0, nu=0.4),
        hold=[Hold(group=f"{c} = 0", components=(c,)) for c in ("x", "y", "z")],
        cavity=list(fluids),
    )


def test_a_cavity_that_is_emptied() -> None:
    found = message(shell(Cavity(group="inner", volume=-1.0)))
    assert "cavity.volume = -1.0: expected a volume that leaves some of the 0.52" in found
    with_less = fem_snh.run(shell(Cavity(group="inner", volume=-0.02)), progress=False)
    assert with_less.converged
    assert with_less.steps[-1]["cavities"]["inner"]["volume"] == pytest.approx(-0.02, rel=0.02)
    assert np.pi / 6 == pytest.approx(0.5236, rel=1e-4)


@pytest.mark.one_debian("ranks")
def test_two_cavities_on_one_surface() -> None:
    one, other = Cavity(group="inner", volume=0.1), Cavity(group="surface:inner", volume=0.2)
    found = message(shell(one, other))
    assert "cavity.group = 'surface:inner': expected a surface that shares no facet with" in found
