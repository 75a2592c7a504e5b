"""Divide the long edges of a surface."""

from __future__ import annotations

import numpy as np

from fem_snh.mesh.lattice.grid import Array, Integers
from fem_snh.mesh.lattice.surface_nets import Triangles


def refine(points: Array, triangles: Integers, longest: float) -> tuple[Array, Triangles]:
    """Return a surface whose edges are not longer than a length; its shape is the same.

    A triangle follows the deformation of a lattice only as finely as its corners do. Long edges
    are halved on both of their sides, so that a closed surface remains closed.

    Parameters
    ----------
    points, triangles : (n, 3) array, (m, 3) int array
        The surface.
    longest : float
        The length.
    """
    triangles = np.asarray(triangles, dtype=np.int64)
    while True:
        sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)  # (m, 3, 2)
        length = np.linalg.norm(points[sides[..., 0]] - points[sides[..., 1]], axis=2)
        edges, number = np.unique(
            np.sort(sides, axis=2)[length > longest], axis=0, return_inverse=True
        )
        if not len(edges):
            return points, triangles.astype(np.int32)
        middle = np.full(triangles.shape, -1)
        middle[length > longest] = len(points) + number.ravel()
        points = np.concatenate([points, points[edges].mean(axis=1)])
        triangles = _divided(triangles, middle)


def _divided(triangles: Integers, middle: Integers) -> Integers:
    """Return the triangles, divided at the midpoints (m, 3) of their edges; -1 for none."""
    count = (middle >= 0).sum(axis=1)
    found = [triangles[count == 0]]
    # Turned so that the edge that is divided alone, or not at all, comes first.
    for turn in range(3):
        a, b, c = np.roll(triangles, -turn, axis=1).T
        ab, bc, ca = np.roll(middle, -turn, axis=1).T
        one = (count == 1) & (ab >= 0)
        found += [np.stack([a, ab, c], 1)[one], np.stack([ab, b, c], 1)[one]]
        two = (count == 2) & (ab < 0)
        parts = ([a, b, bc], [a, bc, ca], [ca, bc, c])
        found += [np.stack(part, axis=1)[two] for part in parts]
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    all_three = ([a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca])
    found += [np.stack(part, axis=1)[count == 3] for part in all_three]
    return np.concatenate(found)
