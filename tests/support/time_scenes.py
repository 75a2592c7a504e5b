"""Small scenes in time, for the tests of runs."""

from __future__ import annotations

from typing import Any

from fem_snh.scenes import Geometry, Gravity, Hold, MaterialChoice, Move, Rotate, Scene, Time

#: E and density of flesh, roughly; the body is a cube of 1 m.
SOFT = MaterialChoice(name="stable_neo_hookean", E=1e4, nu=0.4, density=1000.0)
DOWN = Gravity(vector=(0, 0, -9.81))


def in_time(time: dict[str, Any], **keys: Any) -> Scene:
    """Return a scene of a cube of eight hexahedra with these time steps and tables."""
    common = {
        "name": "cube", "mesh": Geometry(source="cube"), "cells": 2, "element": "Q1",
        "material": SOFT, "petsc": {"snes_scaled_tol": 1e-10},
    }  # fmt: skip
    return Scene(**common | {"time": Time(**time)} | keys)


#: A cube that hangs from its left side and swings.
SWING = {"hold": [Hold(group="left")], "gravity": DOWN}
#: A cube that is turned by one side, with an angle in proportion to time.
TURN = {
    "move": [Move(group="left", rotate=Rotate(axis=(1, 0, 0), angle=1.0, through=(0, 0.5, 0.5)))]
}
