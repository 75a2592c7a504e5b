"""``fem-snh run``: one scene, on however many ranks."""

from __future__ import annotations

import argparse
import signal
from functools import partial
from pathlib import Path
from typing import Any

from fem_snh.cli.options import SCENE_OPTIONS, Parser, assignments, split_petsc, value
from fem_snh.doctor import check
from fem_snh.errors import BadInput, on_root


def run(argv: list[str]) -> int:
    """Solve; 0 if every step converged, 1 if not."""
    from fem_snh import scenes

    parser = Parser("run", "Solve a scene, or a scene file of your own.", scene_list())
    parser.add_argument("scene", metavar="SCENE|FILE.toml", nargs="?")
    for key, placeholder, help in SCENE_OPTIONS:
        parser.add_argument(f"--{key}", metavar=placeholder, type=value, help=help)
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="any other key of the scene: angle=1.57, material.barrier=true",
    )
    parser.add_argument(
        "--accuracy",
        metavar="A",
        help="of displacements: 1%% or 0.01; element, mesh and solver from what was measured",
    )
    parser.add_argument(
        "--accuracy-table",
        metavar="CSV",
        type=Path,
        help="of a `fem-snh tradeoff` of your own; default: the one that comes with the scene",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="write run.json, tables, fields")
    parser.add_argument("--overwrite", action="store_true", help="even if DIR holds a run already")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with the run of this scene in DIR, from its last step, on any number of ranks",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")
    if not argv:
        print("fem-snh run SCENE|FILE.toml [options]\n\n" + scene_list())
        return 0
    words, petsc = split_petsc(argv)
    args = parser.parse(words)
    if args.scene is None:
        raise BadInput(
            f"missing SCENE: expected one of {', '.join(scenes.names())}, or a .toml file"
        )
    overrides = {key: getattr(args, key) for key, _, _ in SCENE_OPTIONS}
    overrides |= {key: value(word) for key, word in assignments(args.set).items()}

    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    # One rank reads the files: the others may not see them, and must not differ in what they find.
    overrides, note = on_root(comm, partial(_by_accuracy, args, overrides))
    if petsc:
        overrides["petsc"] = petsc
    scene = on_root(comm, partial(scenes.load, args.scene, **overrides))
    handler = signal.getsignal(signal.SIGINT)
    check()
    signal.signal(signal.SIGINT, handler)  # gmsh 4.8 takes Ctrl-C away when it is imported
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
    """With --accuracy, the values that it adds to the overrides, and what run.json says of it."""
    if args.accuracy is None:
        if args.accuracy_table is not None:
            raise BadInput("--accuracy-table without --accuracy: say how accurate, e.g. 1%")
        return overrides, {}
    from fem_snh import scenes
    from fem_snh.studies.tradeoff import accuracy

    asked = accuracy.fraction(args.accuracy)
    own = scenes.load(args.scene, **overrides)
    chosen = accuracy.choose(args.scene, own.material.nu, asked, args.accuracy_table)
    overrides = overrides | chosen.values(overrides)
    if not args.quiet:
        print(chosen.message(), flush=True)
        given = [key for key, v in overrides.items() if v is not None]
        if other := [key for key in given if key not in {"nu", *chosen.choice.values()}]:
            print(f"accuracy: measured for the scene as it is, not with other {', '.join(other)}")
    return overrides, chosen.record(asked)


def scene_list() -> str:
    """The built-in scenes with what is their own, as they are now."""
    from fem_snh import scenes

    rows = ["scenes:"]
    for name in scenes.names():
        own = [f"{key}={_short(default)}" for key, default in scenes.own_parameters(name).items()]
        rows += [f"  {name:<9}{scenes.describe(name)}", f"  {'':<9}--set {', '.join(own)}"]
    return "\n".join([*rows, "", "PETSc's options go last, after --: -- -ksp_rtol 1e-6 -snes_view"])


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
