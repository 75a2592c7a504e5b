"""A scene file for the tests of scenes; its mesh does not exist."""

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
