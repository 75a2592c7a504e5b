"""Surface files of a box, which are read, evaluated and put into a lattice."""

from __future__ import annotations

import itertools
import struct
from pathlib import Path
from random import Random

import numpy as np

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import write
from fem_snh.geometry.shapes import ClosedSurface

_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
_TRIANGLES = [(f[0], f[i], f[i + 1]) for f in _FACES for i in (1, 2)]


def make_surface(random: Random, folder: Path) -> list[str]:
    """STL files, text or binary, and OBJ files of a box of any size and order of its faces"""
    # Binary files have single precision: powers of 2.
    low = [float(random.randint(-8, 8)) for _ in "xyz"]
    high = [x + 2.0 ** random.randint(-2, 2) for x in low]
    corners = list(itertools.product(*zip(low, high, strict=True)))
    triangles = [t[i:] + t[:i] for t in _TRIANGLES for i in [random.randrange(3)]]
    random.shuffle(triangles)
    kind = random.choice(("stl", "binary stl", "obj"))
    if kind == "obj":
        corner = random.choice(("{0}", "{0}//{0}", "{0}/{0}/{0}", "{0}/{0}"))
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners]
        if "//" not in corner and "/" in corner and random.random() < 0.7:
            lines += ["vt 0 0"] * len(corners)
        faces = random.choice((_FACES, triangles))
        lines += ["f " + " ".join(corner.format(i + 1) for i in face) for face in faces]
        data = "\n".join([*lines, ""]).encode()
    elif kind == "stl":
        lines = ["solid box"]
        for triangle in triangles:
            points = [" ".join(map(repr, corners[i])) for i in triangle]
            vertices = [f"vertex {point}" for point in points]
            lines += ["facet normal 0 0 0", "outer loop", *vertices, "endloop", "endfacet"]
        data = "\n".join([*lines, "endsolid box", ""]).encode()
    else:
        data = bytes(80) + struct.pack("<I", len(triangles))
        for triangle in triangles:
            numbers = [0.0, 0.0, 0.0, *(x for i in triangle for x in corners[i])]
            data += struct.pack("<12fH", *numbers, 0)
    name = "body.obj" if kind == "obj" else "body.stl"
    state = write(random, folder / name, data, kind == "binary stl")
    return [name, state, *map(repr, (*low, *high))]


def _read(arguments: list[str]) -> int:
    """Read a surface, evaluate it and put it into a lattice."""
    from fem_snh.mesh.lattice import lattice

    name, state, *numbers = arguments
    surface = ClosedSurface.read(name)
    low, high = surface.bounds
    x = low + (high - low) * np.random.default_rng(0).uniform(-0.5, 1.5, (50, 3))
    distance, gradient, _ = surface.evaluate(x)
    assert np.isfinite(distance).all()
    assert np.abs(np.linalg.norm(gradient, axis=1) - 1).max() < 1e-6
    data = lattice(surface, float((high - low).min()) / 2)
    assert len(data.cells) and np.isfinite(data.x).all()
    if state == "whole":
        low, high = np.array(numbers, dtype=float).reshape(2, 3)
        assert np.array_equal(surface.bounds, [low, high])
        beyond = np.maximum(low - x, x - high)  # of a box: Quilez
        exact = np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
        assert np.abs(distance - exact).max() < 1e-12 * surface.diagonal + 1e-12
    return 0


FAMILIES = {"surface": Family(make_surface, _read, ("fem_snh.mesh.lattice",))}
