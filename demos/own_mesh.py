"""A mesh and a scene file of your own: a soft bracket hangs on a bolt, with a weight at its tip.

    mpirun -n 2 python demos/own_mesh.py

Everything is written under out/own_mesh: the gmsh source and mesh, the scene, results, a picture.
"""

from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np

import fem_snh
from fem_snh.render import main as render

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
here, comm = Path("out/own_mesh"), MPI.COMM_WORLD
if comm.rank == 0:  # any .msh with physical groups will do
    here.mkdir(parents=True, exist_ok=True)
    (here / "bracket.geo").write_text(GEOMETRY)
    (here / "bracket.toml").write_text(SCENE)
    gmsh.initialize(["", "-v", "1"])
    gmsh.open(str(here / "bracket.geo"))
    gmsh.model.mesh.generate(3)
    gmsh.write(str(here / "bracket.msh"))
    gmsh.finalize()
comm.Barrier()
result = fem_snh.run(here / "bracket.toml", out=here, overwrite=True)

forces = result.problem.x.duplicate()
result.problem.gradient(result.problem.x, forces)  # at held nodes: the reactions [N]
F = forces.array.reshape(-1, 3)
X = result.problem.V.tabulate_dof_coordinates()[: len(F)]
bolt = comm.allreduce(F[np.hypot(X[:, 0] - 0.25, X[:, 2] - 0.9) < 0.121].sum(axis=0))
if comm.rank == 0:  # the bolt must carry what hangs on the tip: 150 Pa on 0.12 m^2
    print(f"the bolt carries {bolt[2]:.3f} N; picture: {render(here)}")
assert result.converged and np.allclose(bolt, [0, 0, 18], atol=0.02), bolt
