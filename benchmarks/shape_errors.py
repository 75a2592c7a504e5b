"""The estimated errors of bodies with bones and rigid parts that are shapes.

The exact values are those of P2P0 on tetrahedra whose faces are those of the shape, a group.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fem_snh
from benchmarks import Row, split_list
from benchmarks.accuracy_cases import goals_of
from benchmarks.error_estimates import compared, summary
from fem_snh.mesh.gmsh_model import session
from fem_snh.scenes import BoneChoice, Geometry, Hold, MaterialChoice, Probe, Rigid, Scene
from fem_snh.tables.amplitudes import Rotate

#: The middle of the solids in the unit cube, which no mesh knows.
_CENTRE = (0.47, 0.52, 0.55)
_ENDS = ((0.3, 0.52, 0.55), (0.66, 0.52, 0.55))
_SHAPES: dict[str, dict[str, Any]] = {
    "sphere": {"sphere": {"center": _CENTRE, "radius": 0.22}},
    "capsule": {"capsule": {"from": _ENDS[0], "to": _ENDS[1], "radius": 0.17}},
}
#: The motion of a bone, and the loads of a rigid part.
_MOTIONS: dict[str, dict[str, Any]] = {
    "bone": {
        "translate": (0.08, 0.04, 0.06),
        "rotate": Rotate(axis=(0.3, 1, 0), through=_CENTRE, angle=0.35),
    },
    "rigid": {"about": _CENTRE, "force": (0.05, 0.02, 0.03), "torque": (0, 0.01, 0.005)},
}
#: The least bound of an error, over it.
_LEAST_BOUND = 1.0
#: Errors below this part of the largest component are not compared.
_LEAST = 2e-3


def rows(
    shapes: str = "sphere,capsule",
    motions: str = "bone,rigid",
    elements: str = "P1,Q1P0,P2P0,Q2",
    nus: str = "0.3,0.45,0.49",
    cells: str = "5,8",
    reference: float = 0.06,
) -> Iterator[Row]:
    """Yield one row per goal of a shape, a motion, a ratio, an element and a mesh; then a summary.

    Parameters
    ----------
    shapes, motions, elements, nus, cells : str
        Shapes, kinds of solids, elements, Poisson's ratios, cells along an edge.
    reference : float
        Size of the tetrahedra of the reference at the surface, over the edge.

    Yields
    ------
    dict
        As of ``error_estimates``. The summary is of errors that are more than a bound.
    """
    found: list[Row] = []
    with TemporaryDirectory() as folder:
        for shape in split_list(shapes):
            path = Path(folder) / f"{shape}.msh"
            _write_mesh(shape, reference, path)
            for motion in split_list(motions):
                for nu in map(float, split_list(nus)):
                    exact = _exact(motion, nu, path)
                    for element in split_list(elements):
                        for number in map(int, split_list(cells)):
                            case = _scene(motion, nu, shape, element, number)
                            about = {"shape": shape, "motion": motion, "nu": nu}
                            about |= {"element": element, "cells": number}
                            for row in compared(case, about, exact, _LEAST):
                                if "bound" in row:
                                    row["ok"] = row["bound"] >= _LEAST_BOUND
                                else:
                                    found.append(row)
                                yield row
    yield summary(found)


def _exact(motion: str, nu: float, path: Path) -> Mapping[str, float]:
    result = fem_snh.run(_scene(motion, nu, path), progress=False)
    return goals_of(result.steps[-1])


def _scene(motion: str, nu: float, solid: str | Path, element: str = "P2P0", cells: int = 0) -> Any:
    """Return a cube on a clamped bottom with a shape, or with the group of a mesh."""
    kind: Row = {"group": "solid"} if isinstance(solid, Path) else {"shape": _SHAPES[solid]}
    keys: Row = {**kind, "name": "solid", **_MOTIONS[motion]}
    solids: Row = {"rigid": [Rigid(**keys)]}
    if motion == "bone":
        solids = {"bone": [BoneChoice(**keys)], "reactions": ["bottom"]}
    mesh: Row = {"mesh": solid}
    if not isinstance(solid, Path):
        mesh = {"mesh": Geometry(source="cube"), "cells": cells, "error": True}
    return Scene(
        name="cube",
        element=element,
        steps=2,
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=nu),
        hold=[Hold(group="bottom")],
        probe=[Probe(name="top", point=(0.5, 0.5, 1)), Probe(name="side", point=(1, 0.5, 0.5))],
        **mesh,
        **solids,
    )


def _write_mesh(shape: str, size: float, path: Path) -> None:
    """Write second-order tetrahedra of the cube, of which those in the shape are a group."""
    with session() as gmsh:
        occ, model = gmsh.model.occ, gmsh.model
        values = next(iter(_SHAPES[shape].values()))
        radius, cube = values["radius"], occ.addBox(0, 0, 0, 1, 1, 1)
        if shape == "sphere":
            solid = [(3, occ.addSphere(*_CENTRE, radius))]
        else:
            axis = [b - a for a, b in zip(*_ENDS, strict=True)]
            ends = [(3, occ.addSphere(*end, radius)) for end in _ENDS]
            solid = occ.fuse([(3, occ.addCylinder(*_ENDS[0], *axis, radius))], ends)[0]
        inner = occ.fragment([(3, cube)], solid)[1][1]
        occ.synchronize()
        outer = [entity for entity in model.getEntities(3) if entity not in inner]
        bottom = model.getEntitiesInBoundingBox(-0.1, -0.1, -0.1, 1.1, 1.1, 0.1, 2)
        for name, entities in (("flesh", outer), ("solid", inner), ("bottom", bottom)):
            group = model.addPhysicalGroup(entities[0][0], [tag for _, tag in entities])
            model.setPhysicalName(entities[0][0], group, name)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        model.mesh.generate(3)
        model.mesh.setOrder(2)
        model.mesh.optimize("HighOrder")
        gmsh.write(str(path))
