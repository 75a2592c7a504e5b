# %% [markdown]
# # Your own mesh and scene file: a soft bracket
#
# A bracket of gel hangs on a bolt, with a load at its tip. The demo writes a gmsh geometry, meshes
# it, writes a [scene file](../reference/scene_file.md), runs it and checks that the bolt carries
# the load. Everything is under `out/own_mesh`.
#
# ![The deformed bracket, coloured by J](own_mesh.png)
#
# ```bash
# mpirun -n 2 python demos/own_mesh.py
# ```

# %%
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np

import fem_snh
from fem_snh.viewing.render import main as render

# %% [markdown]
# Any mesh with physical groups will do; the scene refers to them by name.

# %%
GEOMETRY = """
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 0.5, 0.3, 1.2};                 // upright
Box(2) = {0, 0, 0, 1.5, 0.3, 0.4};                 // arm
Cylinder(3) = {0.25, 0, 0.9, 0, 0.3, 0, 0.12};     // bolt hole
BooleanUnion(4) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
BooleanDifference(5) = { Volume{4}; Delete; }{ Volume{3}; Delete; };
Physical Volume("bracket") = {5};
Physical Surface("bolt") = Surface In BoundingBox{0.1, -0.1, 0.7, 0.4, 0.4, 1.1};
Physical Surface("tip") = Surface In BoundingBox{1.4, -0.1, -0.1, 1.6, 0.4, 0.5};
MeshSize{ PointsOf{ Volume{5}; } } = 0.14;
"""
SCENE = """
mesh = "bracket.msh"
element = "P2"
steps = 4
material = { name = "stable_neo_hookean", E = 1e4, nu = 0.45 }          # a gel [Pa]
hold = [{ group = "bolt" }]
traction = [{ group = "tip", vector = [0, 0, -150] }]                   # [Pa] on 0.3 m x 0.4 m
"""

# %%
folder, comm = Path("out/own_mesh"), MPI.COMM_WORLD
if comm.rank == 0:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bracket.geo").write_text(GEOMETRY)
    (folder / "bracket.toml").write_text(SCENE)
    gmsh.initialize(["", "-v", "1"])
    gmsh.open(str(folder / "bracket.geo"))
    gmsh.model.mesh.generate(3)
    gmsh.write(str(folder / "bracket.msh"))
    gmsh.finalize()
comm.Barrier()
result = fem_snh.run(folder / "bracket.toml", out=folder, overwrite=True)

# %% [markdown]
# The gradient of the energy at the constrained nodes is the reaction. The bolt carries 150 Pa on
# 0.12 m², 18 N. (With `reactions = ["bolt"]` in the scene, run.json has the same number.)

# %%
forces = result.problem.x.duplicate()
result.problem.gradient(result.problem.x, forces)
F = forces.array.reshape(-1, 3)
X = result.problem.V.tabulate_dof_coordinates()[: len(F)]
bolt = comm.allreduce(F[np.hypot(X[:, 0] - 0.25, X[:, 2] - 0.9) < 0.121].sum(axis=0))
if comm.rank == 0:
    print(f"the bolt carries {bolt[2]:.3f} N; picture: {render(folder)}")
assert result.converged and np.allclose(bolt, [0, 0, 18], atol=0.02), bolt
