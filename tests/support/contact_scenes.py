"""Scenes with obstacles for tests."""

from __future__ import annotations

from typing import Any

from fem_snh.scenes import Scene

PLATE: dict[str, Any] = {
    "name": "plate",
    "shape": {"plane": {"point": [0, 0, 1], "normal": [0, 0, -1]}},
    "translate": [0.06, 0, -0.1],
    "friction": 0.3,
}


def slide(**plate: Any) -> Scene:
    """A block on which a plate presses and slides; ``plate`` has other keys of the obstacle."""
    given = {
        "name": "slide", "mesh": {"source": "cube"}, "cells": 2, "element": "Q1", "steps": 4,
        "predictor": "none", "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        "hold": [{"group": "bottom"}], "obstacle": [PLATE | plate],
        "fields": ["contact_pressure", "gap"], "petsc": {"snes_scaled_tol": 1e-10},
    }  # fmt: skip
    return Scene.model_validate(given)
