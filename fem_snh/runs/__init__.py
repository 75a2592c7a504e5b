"""Runs: from a scene and its options to a `Result`, by load steps, with output and checkpoints.

`driver` is the sequence: `setup` makes the problem, its solver and its steps, `recorder` keeps
run.json, `folder`, `output` and `checkpoint` write the files, `estimates` finds the errors of the
goals in `scene_goals`. `level_runs` runs a scene to an accuracy, on the meshes of `level_meshes`.
`inverse` fits a scene's parameters to a curve.
"""

from __future__ import annotations

from fem_snh.runs.driver import run
from fem_snh.runs.result import Result
from fem_snh.scenes.build import make_mesh

__all__ = ["Result", "make_mesh", "run"]
