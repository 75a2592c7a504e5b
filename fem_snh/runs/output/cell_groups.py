"""The parts of a mesh by its physical groups of cells and by material, which pictures can hide."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.regions import Region
from fem_snh.mesh.mesh import Mesh


class CellGroups(NamedTuple):
    """The parts of a mesh: cells of the same physical groups and of the same material.

    Attributes
    ----------
    names : list of list of str
        The groups of each part, and its material where the body has several.
    numbers : (n,) int array
        The part of each cell that this rank owns.
    """

    names: list[list[str]]
    numbers: npt.NDArray[Any]


def cell_groups(mesh: Mesh, regions: list[Region]) -> CellGroups | None:
    """Return the parts of a mesh; None if all cells are in one. Collective.

    Parameters
    ----------
    mesh : Mesh
        The mesh with its physical groups, which may overlap.
    regions : list of Region
        The materials; rigid cells have none.
    """
    count = _dolfinx.num_owned(mesh.domain)
    groups = [group for group in mesh.groups if group.dim == mesh.dim and group.count]
    # A column for each group, and one with the number of the material.
    kind = np.zeros((count, len(groups) + 1), dtype=np.int32)
    for column, group in enumerate(groups):
        kind[group.entities[group.entities < count], column] = 1
    for number, region in enumerate(regions, 1):
        kind[region.cells, -1] = number
    gathered = np.concatenate(mesh.domain.comm.allgather(np.unique(kind, axis=0)))
    parts, numbers = np.unique(np.concatenate([gathered, kind]), axis=0, return_inverse=True)
    if len(parts) < 2:
        return None
    names = []
    for *members, material in parts:
        found = [group.name for group, member in zip(groups, members, strict=True) if member]
        if material and len(regions) > 1:
            found.append(regions[material - 1].material.numbers.name)
        names.append(found)
    return CellGroups(names, numbers.ravel()[len(gathered) :])
