"""The command ``run``: solve one scene, on any number of ranks."""

from __future__ import annotations

import textwrap
from functools import partial
from typing import TYPE_CHECKING, Any

from fem_snh.cli import start_petsc
from fem_snh.cli.doctor import check
from fem_snh.cli.options import (
    REPEATED,
    SCENE_OPTIONS,
    Parser,
    assignments,
    output,
    split_petsc,
    value,
    with_settings,
)
from fem_snh.errors import BadInput, on_every, on_root
from fem_snh.references import is_reference

if TYPE_CHECKING:
    from mpi4py import MPI

    from fem_snh.scenes import Scene

#: Width of the list of keys in the help.
_WIDTH = 98


def run_parser() -> Parser:
    """Return the parser of ``fem-snh run``."""
    parser = Parser("run", "Solve a scene by load steps.", scene_list)
    parser.add("scene SCENE  a name, FILE.toml or FILE.py:FUNCTION", scene={"nargs": "?"})
    for key, placeholder, help in SCENE_OPTIONS:
        parser.add_argument(f"--{key}", metavar=placeholder, type=value, help=help)
    parser.add(
        """
        --set KEY=VALUE  any other key of the scene: angle=1.57, material.barrier=true
        --error  estimate the errors of probes, reactions, volumes and energy, or of the scene's
            accuracy.goals, after the last step
        --accuracy A  relative error of every goal, 1%% or 0.01: solve on finer and finer meshes
            until the estimated errors are within it; the exit code is 1 if they are not
        --max-time S  begin no level of --accuracy that ends later [s]
        --max-memory MB  nor one whose estimate needs more memory; the estimate of --error is then
            that of coarser meshes
        --max-dofs N  nor one with more unknowns
        --out DIR  folder for run.json, tables and fields
        --overwrite  replace the run in DIR
        --resume  continue the run of this scene in DIR from its last step, on any number of ranks
        --quiet  print no progress
        """,
        set=REPEATED,
        max_time=value,
        max_memory=value,
        max_dofs=value,
        out=output,
    )
    return parser


def run(argv: list[str]) -> int:
    """Solve a scene; return 0 if every step converged, else 1."""
    from fem_snh import scenes

    if not argv:
        print("fem-snh run SCENE [options]\n\n" + scene_list())
        return 0
    words, petsc = split_petsc(argv)
    args = run_parser().parse(words)
    if args.scene is None:
        raise BadInput(
            f"missing SCENE: expected one of {', '.join(scenes.names())}, a .toml file or "
            "FILE.py:NAME"
        )
    options = {key: getattr(args, key) for key, _, _ in SCENE_OPTIONS}
    options |= {"error": args.error or None, "accuracy.within": args.accuracy}
    names = {"accuracy.within": "--accuracy"}
    for key in ("max_time", "max_memory", "max_dofs"):
        options[f"accuracy.{key}"] = getattr(args, key)
        names[f"accuracy.{key}"] = f"--{key.replace('_', '-')}"
    settings = {key: value(word, key) for key, word in assignments(args.set).items()}
    overrides = with_settings(options, settings, names)

    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    scene = load_scene(comm, args.scene, overrides, petsc)
    start_petsc()
    check()
    from fem_snh.runs import run as solve

    result = solve(
        scene,
        out=args.out,
        overwrite=args.overwrite,
        resume=args.resume,
        comm=comm,
        progress=not args.quiet,
    )
    reached = result.record.get("accuracy", {}).get("reached", True)
    return 0 if result.converged and reached else 1


def load_scene(
    comm: MPI.Comm, name: str, overrides: dict[str, Any], petsc: dict[str, str | None]
) -> Scene:
    """Return a scene with other values and PETSc options, on every rank. Collective."""
    from fem_snh import scenes

    if petsc:
        overrides = overrides | {"petsc": petsc}
    # Functions in a scene of a Python file cannot be sent to the other ranks.
    everywhere = on_every if is_reference(name) else on_root
    scene: Scene = everywhere(comm, partial(scenes.load, name, **overrides))
    return scene


def scene_list() -> str:
    """Return the list of built-in scenes with their own parameters and defaults."""
    from fem_snh import scenes

    rows = ["scenes:"]
    for name in scenes.names():
        parameters = [
            f"{key}={_short(default)}" for key, default in scenes.own_parameters(name).items()
        ]
        rows += [f"  {name:<9}{scenes.describe(name)}", f"  {'':<9}--set {', '.join(parameters)}"]
    tables = textwrap.wrap(", ".join(scenes.Scene.model_fields), _WIDTH)
    rows += ["", "keys and tables of a scene:", *(f"  {line}" for line in tables)]
    return "\n".join([*rows, "", "PETSc options go last, after --: -- -ksp_rtol 1e-6 -snes_view"])


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
