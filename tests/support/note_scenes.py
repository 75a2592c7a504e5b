"""Bodies and scenes for the tests of notes: a rubber bushing and a shallow arch."""

from __future__ import annotations

from bodies import create_problem
from gmsh_files import write_msh

import fem_snh
from fem_snh.assembly.elements import element
from fem_snh.mesh.mesh import generate

#: Rubber between two steel sleeves: a hollow cylinder of radii 10 and 20 mm and 30 mm length.
BUSHING = """
n = {n};
For k In {{0:3}}
  c = Cos(k*Pi/2); s = Sin(k*Pi/2);
  Point(10+k) = {{0.01*c, 0.01*s, 0}}; Point(20+k) = {{0.02*c, 0.02*s, 0}};
EndFor
Point(1) = {{0, 0, 0}};
For k In {{0:3}}
  Circle(10+k) = {{10+k, 1, 10+(k+1)%4}}; Circle(20+k) = {{20+k, 1, 20+(k+1)%4}};
  Line(30+k) = {{10+k, 20+k}};
EndFor
For k In {{0:3}}
  Curve Loop(k+1) = {{10+k, 30+(k+1)%4, -(20+k), -(30+k)}};
  Plane Surface(k+1) = {{k+1}};
EndFor
Transfinite Curve{{10:13, 20:23}} = 2*n+1; Transfinite Curve{{30:33}} = n+1;
Transfinite Surface{{1:4}};
{recombine}
out[] = Extrude {{0, 0, 0.03}} {{ Surface{{1:4}}; Layers{{2*n}}; {layers} }};
Physical Volume("rubber") = {{out[1], out[7], out[13], out[19]}};
Physical Surface("inner") = {{out[2], out[8], out[14], out[20]}};
Physical Surface("outer") = {{out[4], out[10], out[16], out[22]}};
"""
BUSHING_SCENE = """mesh = "mesh.msh"
element = "{element}"
steps = 2
reactions = ["inner"]
material = {{ name = "stable_neo_hookean", E = 1e6, nu = {nu} }}
hold = [{{ group = "outer" }}]
move = [{{ group = "inner", {motion} }}]
"""

#: A parabolic strip of 1 m span, 20 mm thick and 100 mm wide, under a dead load.
ARCH = """
n = 12;
For k In {{0:20}}
  x = k/20;
  Point(1+k) = {{x, 0, 4*{rise}*x*(1-x) - 0.01}}; Point(101+k) = {{x, 0, 4*{rise}*x*(1-x) + 0.01}};
EndFor
Spline(1) = {{1:21}}; Spline(2) = {{101:121}}; Line(3) = {{1, 101}}; Line(4) = {{21, 121}};
Curve Loop(1) = {{1, 4, -2, -3}}; Plane Surface(1) = {{1}};
Transfinite Curve{{1, 2}} = n+1; Transfinite Curve{{3, 4}} = 2;
Transfinite Surface{{1}} = {{1, 21, 121, 101}}; Recombine Surface{{1}};
out[] = Extrude {{0, 0.1, 0}} {{ Surface{{1}}; Layers{{1}}; Recombine; }};
Physical Volume("strip") = {{out[1]}};
Physical Surface("ends") = {{out[3], out[5]}};
Physical Surface("left") = {{out[5]}};
Physical Surface("top") = {{out[4]}};
"""
ARCH_SCENE = """mesh = "mesh.msh"
element = "Q2"
steps = {steps}
material = {{ name = "stable_neo_hookean", E = 1e6, nu = 0.3 }}
hold = [{{ group = "{hold}" }}]
traction = [{{ group = "top", vector = [0, 0, {pressure}] }}]
probe = [{{ name = "middle", point = [0.5, 0.05, {height}] }}]
"""


def bushing(comm, folder, element, nu, n=2, motion="translate = [0.0005, 0, 0]"):
    """Return the scene file of a bushing whose inner sleeve moves."""
    if not (folder / "mesh.msh").exists():
        bricks = element.startswith("Q")
        recombine, layers = ("Recombine Surface{1:4};", "Recombine;") if bricks else ("", "")
        write_msh(comm, folder, BUSHING.format(n=n, recombine=recombine, layers=layers))
    return scene(comm, folder, BUSHING_SCENE.format(element=element, nu=nu, motion=motion))


def arch(comm, folder, steps, pressure, rise=0.06, hold="ends"):
    """Return the scene file of an arch, or of a strip without a rise."""
    write_msh(comm, folder, ARCH.format(rise=rise))
    values = {"steps": steps, "pressure": pressure, "hold": hold, "height": rise}
    return scene(comm, folder, ARCH_SCENE.format(**values))


def scene(comm, folder, text):
    """Write the scene file on rank 0."""
    path = folder / "scene.toml"
    if comm.rank == 0:
        path.write_text(text)
    comm.barrier()
    return path


def cube(comm, cells, name, nu, displacement):
    """A unit cube with a given displacement."""
    mesh = generate(comm, "cube", element(name).cell, cells=cells)
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=nu)
    problem = create_problem(mesh, element(name), material)
    problem.x.array[:] = displacement(problem.coordinates).ravel()
    return problem
