"""Built-in scenes and scene files, and overrides of their values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fem_snh import materials, scenes
from fem_snh.scenes import Scene

#: Scenes on a built-in geometry: the others are lattices.
ON_GEOMETRY = [n for n in scenes.names() if isinstance(scenes.load(n).mesh, scenes.Geometry)]
#: Those with each kind of cell that their mesh can have: no hexahedra fill an octopus or an arm.
MESHES = [
    (name, element)
    for name in ON_GEOMETRY
    for element in ("Q1", "P1")
    if name not in ("squash", "elbow", "biceps") or element != "Q1"
]


#: Cells of a mesh that is coarse: larger cells would cut an arm's bones.
COARSE = {"elbow": 12, "biceps": 12}


@pytest.mark.one_debian
@pytest.mark.parametrize("name, element", MESHES)
def test_groups_of_a_scene_are_in_its_mesh(name: str, element: str, comm: Any) -> None:
    from fem_snh.scenes.build import make_mesh

    scene = scenes.load(name, cells=COARSE.get(name, 4), element=element)
    mesh = make_mesh(comm, scene)
    groups = [c.group for c in (*scene.hold, *scene.move, *scene.traction)]
    for group in (*groups, *(reaction.group for reaction in scene.reactions)):
        assert mesh.group(group).count > 0


@pytest.mark.parametrize("name", scenes.names())
def test_scene_survives_a_round_trip(name: str) -> None:
    scene = scenes.load(name)
    assert Scene.model_validate(scene.model_dump()) == scene


def test_overrides_reach_every_level() -> None:
    scene = scenes.load(
        "twist", nu=np.float32(0.25), cells=np.int64(3), angle=1.0, element="P2", steps=None,
        petsc={"-ksp_rtol": 1e-4, "snes_view": None},
        **{"material.barrier": True, "move.0.rotate.through": np.zeros(3), "petsc.a.b": 1},
    )  # fmt: skip
    assert (scene.material.nu, scene.cells, scene.element, scene.steps) == (0.25, 3, "P2", 2)
    assert scene.material.parameters == {"barrier": True}
    rotate = scene.move[0].rotate
    assert rotate is not None and rotate.angle == 1.0 and rotate.through == (0, 0, 0)
    added = {"ksp_rtol": 1e-4, "snes_view": None, "a.b": 1}
    assert scene.petsc == scenes.load("twist").petsc | added


def test_another_material_drops_the_shape_parameters_of_the_first(toml: Path) -> None:
    assert scenes.load(toml).material.parameters == {"barrier": True}
    other = scenes.load(toml, material="neo_hookean").material
    assert (other.name, other.E, other.nu, other.parameters) == ("neo_hookean", 1e4, 0.49, {})
    assert scenes.load(toml, material="stable_neo_hookean").material.parameters


def test_what_any_material_takes_beside_its_own() -> None:
    tuning = {
        "material.alpha_mu": 2, "material.alpha_lambda": np.float64(0.5), "material.alpha": None,
        "material.lambda_part": "neo_hookean", "material.epsilon": 0,
    }  # fmt: skip
    assert {key.partition(".")[2] for key in tuning} == set(materials.TUNING)
    given = scenes.load("twist", **{"material.barrier": True}, **tuning).material.parameters
    assert given == {
        "barrier": True, "alpha": None, "alpha_mu": 2.0, "alpha_lambda": 0.5,
        "lambda_part": "neo_hookean", "epsilon": 0.0,
    }  # fmt: skip
    assert isinstance(given["alpha_mu"], float)


def test_scene_file(toml: Path) -> None:
    scene = scenes.load(str(toml))
    assert (scene.name, scene.mesh) == ("block", toml.parent / "block.msh")
    assert scene.hold[0].components == ("x",) and scene.move[0].group == 7
    assert scene.petsc == {"ksp_rtol": 1e-6, "snes_monitor": True}
    assert scene.traction[0].vector == (0, 6.25, 0)
    assert scene.quadrature == 4
    assert (scene.probe[0].name, scene.probe[0].point) == ("tip", (1, 0.5, 0))
