"""A gmsh geometry and .msh files for the tests of meshes."""

from __future__ import annotations

from contextlib import contextmanager

from fem_snh.mesh.gmsh_model import session

# A box of two volumes, meshed with 2 cells along each edge of each; groups that overlap, have
# gaps in their numbers, no names, or the same number in two dimensions.
BOX = """
Point(1) = {0, 0, 0};
line[] = Extrude {0, 1, 0} { Point{1}; Layers{2}; Recombine; };
base[] = Extrude {0, 0, 1} { Line{line[1]}; Layers{2}; RECOMBINE };
one[] = Extrude {1, 0, 0} { Surface{base[1]}; Layers{2}; RECOMBINE };
two[] = Extrude {1, 0, 0} { Surface{one[0]}; Layers{2}; RECOMBINE };
Point(100) = {5, 5, 5};
Physical Volume("all", 7) = {one[1], two[1]};
Physical Volume("second", 3) = {two[1]};
Physical Surface("start", 3) = {base[1]};
Physical Surface("middle") = {one[0]};
Physical Surface("both ends", 20) = {base[1], two[0]};
Physical Curve("edge") = {line[1]};
Physical Point(42) = {1};
Physical Point("astray") = {100};
"""


@contextmanager
def gmsh_model(script: str, folder):
    """gmsh with a script's geometry, on rank 0 (others get None and must skip the body)."""
    (folder / "script.geo").write_text(script + "\n")  # gmsh skips a last line without it
    with session() as gmsh:
        gmsh.open(str(folder / "script.geo"))
        yield gmsh


@contextmanager
def section(path, order: int = 1):
    """Yield gmsh's geometry and tables of groups, curves and surfaces; then mesh and write them."""
    with session() as gmsh:
        geo, curves, surfaces = gmsh.model.geo, {}, {}
        yield geo, curves, surfaces
        geo.synchronize()
        for dim, groups in ((1, curves), (2, surfaces)):
            for name, tags in groups.items():
                group = gmsh.model.addPhysicalGroup(dim, tags)
                gmsh.model.setPhysicalName(dim, group, name)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(order)
        gmsh.write(str(path))


def write_msh(comm, folder, script: str, version=4.1, order=1, binary=False, dim=3):
    """The mesh of a gmsh script as a .msh file, written by rank 0."""
    path = folder / "mesh.msh"
    if comm.rank == 0:
        with gmsh_model(script, folder) as gmsh:
            gmsh.model.mesh.generate(dim)
            gmsh.model.mesh.setOrder(order)
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.write(str(path))
    comm.barrier()
    return path
