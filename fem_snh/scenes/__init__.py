"""Scenes: an experiment is a function that returns a `Scene`, or a TOML file with the same tables.

The built-in scenes are the modules of ``builtin/``. A package adds scenes by the entry point group
``fem_snh.scenes``; a function in a Python file is given as ``FILE.py:NAME``. This package imports
meshes and materials, never the solver.

>>> from fem_snh import scenes
>>> scenes.load("twist", nu=0.3, angle=1.57, **{"material.barrier": True}).material.nu
0.3
"""

from __future__ import annotations

from fem_snh.contact.contact_tables import Contact, SelfContact
from fem_snh.contact.obstacle import Obstacle
from fem_snh.scenes._bones import BoneChoice, Rig
from fem_snh.scenes._consistency import check_consistency, condensation_reason, group_references
from fem_snh.scenes._material import MaterialChoice
from fem_snh.scenes._outputs import (
    Accuracy,
    Geometry,
    GoalName,
    Lattice,
    Modes,
    Probe,
    Reaction,
    Tetrahedra,
    read_goal,
    term_goals,
)
from fem_snh.scenes._reading import (
    FEATURES,
    GROUP,
    describe,
    function,
    load,
    load_to_run,
    names,
    own_parameters,
    read_toml,
    register_feature,
    validate,
)
from fem_snh.scenes.schema import Damping, Scene, Start, Time
from fem_snh.tables.amplitudes import Amplitude, Rotate
from fem_snh.terms.cavity import Cavity
from fem_snh.terms.dirichlet import Hold, Move, Symmetry
from fem_snh.terms.loads import Gravity, Pressure, Spring, Traction
from fem_snh.terms.rigid import Rigid

__all__ = [
    "FEATURES",
    "GROUP",
    "Accuracy",
    "Amplitude",
    "BoneChoice",
    "Cavity",
    "Contact",
    "Damping",
    "Geometry",
    "GoalName",
    "Gravity",
    "Hold",
    "Lattice",
    "MaterialChoice",
    "Modes",
    "Move",
    "Obstacle",
    "Pressure",
    "Probe",
    "Reaction",
    "Rig",
    "Rigid",
    "Rotate",
    "Scene",
    "SelfContact",
    "Spring",
    "Start",
    "Symmetry",
    "Tetrahedra",
    "Time",
    "Traction",
    "check_consistency",
    "condensation_reason",
    "describe",
    "function",
    "group_references",
    "load",
    "load_to_run",
    "names",
    "own_parameters",
    "read_goal",
    "read_toml",
    "register_feature",
    "term_goals",
    "validate",
]  # fmt: skip
