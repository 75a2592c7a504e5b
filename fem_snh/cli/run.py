"""The commands ``run`` and ``sweep``: solve one scene, or many in processes of their own."""

from __future__ import annotations

import os
import textwrap
import tomllib
from functools import partial
from typing import TYPE_CHECKING, Any

from fem_snh import cli, references, scenes
from fem_snh.cli.doctor import check
from fem_snh.cli.options import (
    REPEATED,
    Parser,
    assignments,
    output,
    split_petsc,
    value,
    values_of,
    with_settings,
)
from fem_snh.errors import BadInput, choose, on_every, on_root

if TYPE_CHECKING:
    from mpi4py import MPI

#: Scene keys with an option of their own, and their placeholders.
SCENE_OPTIONS = {
    "material": "NAME", "E": "X", "nu": "X", "cells": "N", "element": "E", "quadrature": "N",
    "hessian": "H", "globalization": "G", "steps": "N", "predictor": "P",
}  # fmt: skip
#: Width of the list of keys in the help.
_WIDTH = 98


def run_parser() -> Parser:
    """Return the parser of ``fem-snh run``."""
    keys = scenes.Scene.model_fields
    parser = Parser("run", "Solve a scene by load steps.", epilog=scene_list, keys=keys)
    parser.add("scene SCENE  a name, FILE.toml or FILE.py:FUNCTION", scene={"nargs": "?"})
    _add_scene_options(parser, type=value)
    parser.add(
        """
        --set KEY=VALUE  any other key of the scene: angle=1.57, material.barrier=true
        --error  estimate the errors of probes, reactions, volumes and energy, or of the scene's
            accuracy.goals, after the last step
        --accuracy A  relative error of every goal, 1%% or 0.01: solve on finer and finer meshes
            until the estimated errors are within it; the exit code is 1 if they are not
        --max-time S  begin no level of --accuracy that ends later [s]; give one up that takes
            twice as long
        --max-memory MB  nor one whose estimate needs more memory; nor an estimate of --error
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
    options = {key: vars(args)[key] for key in SCENE_OPTIONS}
    names = {"accuracy.within": "accuracy"}
    names |= {f"accuracy.{name}": name for name in ("max_time", "max_memory", "max_dofs")}
    options["error"] = args.error or None
    options |= {key: vars(args)[name] for key, name in names.items()}
    overrides = with_settings(options, values_of(args.set), names)

    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    scene = load_scene(comm, args.scene, overrides, petsc)
    cli.start_petsc()
    check()
    from fem_snh.runs import run as solve

    cli.start_collector()
    result = solve(
        scene, out=args.out, overwrite=args.overwrite, resume=args.resume, comm=comm,
        progress=not args.quiet,
    )  # fmt: skip
    reached = result.record.get("accuracy", {}).get("reached", True)
    return 0 if result.converged and reached else 1


def load_scene(
    comm: MPI.Comm, name: str, overrides: dict[str, Any], petsc: dict[str, str | None]
) -> scenes.Scene:
    """Return a scene with keys and PETSc options overridden, on every rank. Collective."""
    if petsc:
        overrides = overrides | {"petsc": petsc}
    # Functions in a scene of a Python file cannot be sent to the other ranks.
    everywhere = on_every if references.is_reference(name) else on_root
    scene: scenes.Scene = everywhere(comm, partial(scenes.load, name, **overrides))
    return scene


def _add_scene_options(parser: Parser, more: str = "", **settings: Any) -> None:
    """Add `SCENE_OPTIONS`, with the scene's descriptions of its keys as help.

    Parameters
    ----------
    parser : Parser
        The parser.
    more : str
        Text after each placeholder.
    **settings
        Further keywords of `argparse.ArgumentParser.add_argument`.
    """
    of_material = scenes.MaterialChoice.model_fields
    fields = of_material | scenes.Scene.model_fields | {"material": of_material["name"]}
    for key, placeholder in SCENE_OPTIONS.items():
        help = (fields[key].description or "").rstrip(".").replace("%", "%%")
        parser.add_argument(f"--{key}", metavar=placeholder + more, help=help, **settings)


def scene_list() -> str:
    """Return the list of built-in scenes with their own parameters and defaults."""
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


def sweep_parser() -> Parser:
    """Return the parser of ``fem-snh sweep``."""
    parser = Parser(
        "sweep",
        "Solve a scene for every combination of values, --jobs of them at a time.\n"
        "Every option of a scene takes a comma list: --nu 0.3,0.45 --material a,b --set angle=1,2",
        epilog=scene_list,
        keys=scenes.Scene.model_fields,
    )
    parser.add("scene SCENE  a name, FILE.toml or FILE.py:FUNCTION", scene={})
    _add_scene_options(parser, ",..")
    parser.add("--set KEY=VALUE,..  any other key of the scene: angle=1,2", set=REPEATED)
    parser.add(
        """
        --error  estimate the errors of the numbers of every point
        --out DIR  the sweep's folder
        --render FIELD  also draw the bodies of all points in one picture, bodies.png, with the
            colours of a field; default: J
        --jobs J  number of points that run at a time; default: 1
        --ranks R  number of MPI ranks of each point; default: 1
        --timeout S  seconds after which a point is terminated
        --memory GIB  memory above which a point is terminated
        --retry  run failed points again
        --overwrite  discard the points in the folder
        --scheduler NAME  submit the points as arrays of jobs and return: slurm
        --account NAME  account of the jobs
        --partition NAME  partition of the jobs
        --array-limit N  number of elements of an array that run at a time
        --scheduler-option OPTION  further option of sbatch, e.g. --qos=long; may be repeated
        """,
        out={"type": output, "required": True},
        render={"nargs": "?", "const": "J"},
        jobs={"type": value, "default": 1},
        ranks={"type": value, "default": 1},
        timeout=value,
        memory=value,
        array_limit=value,
        scheduler_option=REPEATED,
    )
    return parser


def sweep(argv: list[str]) -> int:
    """Solve every point; return 0 if all converged, else 1."""
    words, petsc = split_petsc(argv)
    args = sweep_parser().parse(words)
    if int(os.environ.get("OMPI_COMM_WORLD_SIZE", os.environ.get("PMI_SIZE", 1))) > 1:
        raise BadInput("sweep under mpirun: it starts the ranks itself; use --ranks R instead")
    options = {key: vars(args)[key] for key in SCENE_OPTIONS}
    options["error"] = "true" if args.error else None
    given = with_settings(options, assignments(args.set))
    axes = {key: comma_list(key, text) for key, text in given.items()}

    from fem_snh.studies.sweep import NO_NOTES, Slurm
    from fem_snh.studies.sweep import sweep as study

    jobs = args.jobs
    if args.scheduler is not None:
        choose("scheduler", args.scheduler, ["slurm"])
        jobs = Slurm(args.account, args.partition, args.array_limit, args.scheduler_option)
    keys = ("ranks", "timeout", "memory", "retry", "overwrite", "render")
    chosen = {key: vars(args)[key] for key in keys}
    table = study(args.scene, args.out, axes, jobs=jobs, petsc=petsc, **chosen)
    good = int(table["converged"].sum())
    noted = int(table["notes"].ne(NO_NOTES).sum())
    remark = f", {noted} with notes" if noted else ""
    print(f"{good} of {len(table)} points converged{remark}: {args.out / 'sweep.csv'}")
    return 0 if good == len(table) else 1


def comma_list(key: str, text: str) -> list[Any]:
    """Return the values of a comma-separated text, in TOML or as words, or raise BadInput."""
    try:
        values: list[Any] = tomllib.loads(f"values = [{text}]")["values"]
    except ValueError:
        parts = [part.strip() for part in text.split(",")]
        values = [value(part, key) for part in parts] if all(parts) else []
    if not values:
        raise BadInput(f"{key} = '{text}': expected values with commas between, e.g. 0.3,0.45")
    return values
