"""Runs: from a scene and its options to a `Result`, by load steps, with output and checkpoints.

`run` is the sequence of steps; ``setup`` makes the problem and its solver, ``stepping`` halves
failed load steps, ``recorder`` keeps run.json, ``folder``, ``fields`` and ``checkpoint`` write the
files.
"""

from __future__ import annotations

from fem_snh.runs.driver import run
from fem_snh.runs.result import Result
from fem_snh.runs.scene_mesh import make_mesh

__all__ = ["Result", "make_mesh", "run"]
