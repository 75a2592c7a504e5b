"""Damaged surface files, which are read, evaluated and put into a lattice."""

from __future__ import annotations

import struct
from pathlib import Path
from random import Random

import numpy as np

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import mutate
from fem_snh.geometry.shapes import ClosedSurface

#: Corners and triangles of a box.
_CORNERS = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 0.7) for z in (0.0, 0.4)]
_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
_TRIANGLES = [(f[0], f[i], f[i + 1]) for f in _FACES for i in (1, 2)]


def make_surface(random: Random, folder: Path) -> list[str]:
    """STL files, text or binary, and OBJ files of a closed surface"""
    kind = random.choice(("stl", "binary stl", "obj"))
    if kind == "obj":
        corner = random.choice(("{0}", "{0}//{0}", "{0}/{0}/{0}", "{0}/{0}"))
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in _CORNERS]
        if "//" not in corner and "/" in corner and random.random() < 0.7:
            lines += ["vt 0 0"] * len(_CORNERS)
        faces = random.choice((_FACES, _TRIANGLES))
        lines += ["f " + " ".join(corner.format(i + 1) for i in face) for face in faces]
        data = "\n".join([*lines, ""]).encode()
    elif kind == "stl":
        lines = ["solid box"]
        for triangle in _TRIANGLES:
            points = [" ".join(map(repr, _CORNERS[i])) for i in triangle]
            vertices = [f"vertex {point}" for point in points]
            lines += ["facet normal 0 0 0", "outer loop", *vertices, "endloop", "endfacet"]
        data = "\n".join([*lines, "endsolid box", ""]).encode()
    else:
        data = bytes(80) + struct.pack("<I", len(_TRIANGLES))
        for triangle in _TRIANGLES:
            numbers = [0.0, 0.0, 0.0, *(x for i in triangle for x in _CORNERS[i])]
            data += struct.pack("<12fH", *numbers, 0)
    if random.random() < 0.98:
        data = mutate(random, data, kind == "binary stl")
    name = "body.obj" if kind == "obj" else "body.stl"
    (folder / name).write_bytes(data)
    return [name]


def _read(arguments: list[str]) -> int:
    """Read a surface, evaluate it and put it into a lattice."""
    from fem_snh.mesh.lattice.create import lattice

    surface = ClosedSurface.read(arguments[0])
    low, high = surface.bounds
    x = low + (high - low) * np.random.default_rng(0).uniform(-0.5, 1.5, (50, 3))
    distance, gradient, _ = surface.evaluate(x)
    assert np.isfinite(distance).all()
    assert np.abs(np.linalg.norm(gradient, axis=1) - 1).max() < 1e-6
    data = lattice(surface, float((high - low).min()) / 2)
    assert len(data.cells) and np.isfinite(data.x).all()
    return 0


FAMILIES = {"surface": Family(make_surface, _read, ("fem_snh.mesh.lattice.create",))}
