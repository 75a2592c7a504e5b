"""The command ``run``: solve one scene, on any number of ranks."""

from __future__ import annotations

import argparse
import textwrap
from functools import partial
from pathlib import Path
from typing import Any

from fem_snh.cli.doctor import check
from fem_snh.cli.options import (
    REPEATED,
    SCENE_OPTIONS,
    Parser,
    assignments,
    output,
    split_petsc,
    value,
)
from fem_snh.errors import BadInput, on_every, on_root
from fem_snh.references import is_reference

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
        --accuracy A  relative accuracy of displacements, 1%% or 0.01: choose element, mesh and
            solver from the measured accuracy-cost table of the scene
        --accuracy-table CSV  table of a `fem-snh tradeoff` study for --accuracy; default: the table
            of the built-in scene
        --out DIR  folder for run.json, tables and fields
        --overwrite  replace the run in DIR
        --resume  continue the run of this scene in DIR from its last step, on any number of ranks
        --quiet  print no progress
        """,
        set=REPEATED,
        accuracy_table=Path,
        out=output,
    )
    return parser


def run(argv: list[str]) -> int:
    """Solve a scene; return 0 if every step converged, else 1."""
    from fem_snh import scenes

    parser = run_parser()
    if not argv:
        print("fem-snh run SCENE [options]\n\n" + scene_list())
        return 0
    words, petsc = split_petsc(argv)
    args = parser.parse(words)
    if args.scene is None:
        raise BadInput(
            f"missing SCENE: expected one of {', '.join(scenes.names())}, a .toml file or "
            "FILE.py:NAME"
        )
    overrides = {key: getattr(args, key) for key, _, _ in SCENE_OPTIONS}
    overrides |= {key: value(word) for key, word in assignments(args.set).items()}

    if args.error:
        overrides["error"] = True

    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    # Rank 0 alone reads the files: the other ranks may not see the same file system.
    overrides, note = on_root(comm, partial(_by_accuracy, args, overrides))
    if petsc:
        overrides["petsc"] = petsc
    # Functions in a scene of a Python file cannot be sent to the other ranks.
    everywhere = on_every if is_reference(args.scene) else on_root
    scene = everywhere(comm, partial(scenes.load, args.scene, **overrides))
    check()
    from fem_snh.runs import run as solve

    result = solve(
        scene,
        out=args.out,
        overwrite=args.overwrite,
        resume=args.resume,
        comm=comm,
        progress=not args.quiet,
        note=note,
    )
    return 0 if result.converged else 1


def _by_accuracy(
    args: argparse.Namespace, overrides: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the overrides with the values that --accuracy chooses, and its record for run.json."""
    if args.accuracy is None:
        if args.accuracy_table is not None:
            raise BadInput("--accuracy-table: expected with --accuracy, e.g. --accuracy 1%")
        return overrides, {}
    from fem_snh import scenes
    from fem_snh.studies.tradeoff import accuracy

    accuracy_asked = accuracy.fraction(args.accuracy)
    scene = scenes.load(args.scene, **overrides)
    chosen = accuracy.choose(args.scene, scene.nu, accuracy_asked, args.accuracy_table, scene)
    changed = chosen.changes(scene)
    overrides = overrides | chosen.values(overrides)
    if not args.quiet:
        print(chosen.message(), flush=True)
        if line := accuracy.changes_message(changed):
            print(line, flush=True)
        given = [key for key, v in overrides.items() if v is not None]
        if other := [key for key in given if key not in {"nu", *chosen.choice.values()}]:
            print(f"accuracy: the table was measured without changes of {', '.join(other)}")
    return overrides, chosen.record(accuracy_asked, changed)


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
