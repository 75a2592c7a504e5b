"""A scene file for the tests of scenes; its mesh does not exist."""

from fem_snh.scenes import Scene
from fem_snh.tables.amplitudes import ScaledMotion

TOML = """
mesh = "block.msh"
element = "P2"
steps = 4
quadrature = 4
[material]
name = "stable_neo_hookean"
E = 1e4
nu = 0.49
barrier = true
[[hold]]
group = "left"
components = ["x"]
[[move]]
group = 7
rotate = { axis = [1, 0, 0], through = [0, 0, 0], angle = 1.57 }
[[traction]]
group = "top"
vector = [0, 6.25, 0]
[[probe]]
name = "tip"
point = [1, 0.5, 0]
[petsc]
-ksp_rtol = 1e-6
snes_monitor = true
"""

#: A bar of two materials.
TWO_MATERIALS = """
mesh = { source = "bar" }
cells = 1
element = "Q1"
material = [
    { group = "second", name = "stable_neo_hookean", E = 4.0, nu = 0.45, density = 3000 },
    { name = "neo_hookean", E = 1.0, nu = 0.3 },
]
hold = [{ group = "left" }]
move = [{ group = "right", translate = [0.2, 0, 0] }]
"""


def motions_of(scene: Scene) -> list[ScaledMotion]:
    """Return the motions of a scene's [[move]] with their amplitudes."""
    return [move.scaled(scene.amplitudes) for move in scene.move]
