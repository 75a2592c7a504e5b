"""A bar with two capsules, the bones of an arm."""

from __future__ import annotations

from fem_snh.scenes import Geometry, MaterialChoice, Rigid, Scene

TIGHT = {"snes_scaled_tol": 1e-12, "snes_linear_solver": "direct"}


UPPER = {"capsule": {"from": (0.3, 0.5, 0.5), "to": (1.2, 0.5, 0.5), "radius": 0.3}}


LOWER = {"capsule": {"from": (1.8, 0.5, 0.5), "to": (2.7, 0.5, 0.5), "radius": 0.3}}


ELBOW = (1.5, 0.5, 0.5)


HINGE = {"kind": "hinge", "axis": (0, 0, 1), "through": ELBOW, "to": "upper"}


def arm(**keys):
    """Return a bar with two capsules on its axis, which have a node at the elbow in common."""
    given = {
        "mesh": Geometry(source="bar", parameters={"length": 3, "interface": 1.5}),
        "cells": 4,
        "element": "Q1P0",
        "material": MaterialChoice(name="stable_neo_hookean", E=2e4, nu=0.488),
        "petsc": TIGHT,
    }
    return Scene(name="arm", **given | keys)


def parts(**lower):
    upper = Rigid(name="upper", shape=UPPER, translate=(0, 0, 0))
    return [upper, Rigid(name="lower", shape=LOWER, **lower)]
