"""Scenes with bones for tests: a bar [0, 2] x [0, 1]^2 with two capsules along its axis."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fem_snh.scenes import Scene

UPPER = {"capsule": {"from": [0.2, 0.5, 0.5], "to": [0.8, 0.5, 0.5], "radius": 0.3}}
LOWER = {"capsule": {"from": [1.2, 0.5, 0.5], "to": [1.8, 0.5, 0.5], "radius": 0.3}}
ELBOW = np.array([1.0, 0.5, 0.5])


def bar(*bones, cells=2, element="Q1P0", **keys):
    """Return a scene of the bar with some bones."""
    given = {
        "name": "bar", "mesh": {"source": "bar"}, "cells": cells, "element": element, "steps": 1,
        "material": {"name": "stable_neo_hookean", "E": 1e4, "nu": 0.45},
        "bone": [{"name": f"bone_{i}", **bone} for i, bone in enumerate(bones)],
    }  # fmt: skip
    return Scene(**given | keys)


def matrix(A, c=(0.0, 0.0, 0.0), through=(0.0, 0.0, 0.0)):
    """Return [A | c] of x = A (X - through) + through + c."""
    A = np.asarray(A, dtype=float)
    return np.column_stack([A, np.asarray(c) + through - A @ through])


def turn(angle, axis=(0.0, 0.0, 1.0), through=ELBOW):
    """Return [R | c] of a rotation [rad] about an axis."""
    unit = np.asarray(axis) / np.linalg.norm(axis)
    return matrix(Rotation.from_rotvec(angle * unit).as_matrix(), through=through)


def csv_text(first, *rows):
    """Return a CSV file with rows (load or time, bone, 3x4 matrix)."""
    names = [f"a{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3, 4)]
    lines = [",".join([first, "bone", *names])]
    for at, bone, affine in rows:
        lines.append(",".join([repr(at), bone, *(repr(float(a)) for a in np.ravel(affine))]))
    return "\n".join(lines) + "\n"
