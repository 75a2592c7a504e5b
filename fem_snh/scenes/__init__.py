"""Scenes: an experiment is a function that returns a `Scene`, or a TOML file with the same tables.

The built-in scenes are the modules of ``builtin/``. A package adds scenes by the entry point group
``fem_snh.scenes``; a function in a Python file is given as ``FILE.py:NAME``. Scenes know meshes and
materials, never the solver.

>>> from fem_snh import scenes
>>> scenes.load("twist", nu=0.3, angle=1.57, **{"material.barrier": True}).material.nu
0.3
"""

from __future__ import annotations

from fem_snh.scenes._consistency import check_consistency, group_references, why_condensed
from fem_snh.scenes._features import FEATURES, register_feature
from fem_snh.scenes._library import GROUP, describe, function, names, own_parameters
from fem_snh.scenes._loading import load, load_to_run, read_toml, validate
from fem_snh.scenes._outputs import LARGEST, GoalName, read_goal, term_goals
from fem_snh.scenes.schema import (
    Accuracy,
    Amplitude,
    BoneChoice,
    Cavity,
    Contact,
    Damping,
    Geometry,
    Gravity,
    Hold,
    Lattice,
    MaterialChoice,
    Modes,
    Move,
    Obstacle,
    Pressure,
    Probe,
    Reaction,
    Rig,
    Rigid,
    Rotate,
    Scene,
    SelfContact,
    Spring,
    Start,
    Symmetry,
    Tetrahedra,
    Time,
    Traction,
)

__all__ = [
    "FEATURES", "GROUP", "LARGEST", "Accuracy", "Amplitude", "BoneChoice", "Cavity",
    "Contact", "Damping", "Geometry", "GoalName", "Gravity", "Hold", "Lattice", "MaterialChoice",
    "Modes", "Move", "Obstacle", "Pressure", "Probe", "Reaction", "Rig", "Rigid", "Rotate", "Scene",
    "SelfContact", "Spring", "Start", "Symmetry", "Tetrahedra", "Time", "Traction",
    "check_consistency", "describe", "function", "group_references", "load", "load_to_run", "names",
    "own_parameters", "read_goal", "read_toml", "register_feature", "term_goals", "validate",
    "why_condensed",
]  # fmt: skip
