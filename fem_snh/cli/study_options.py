"""The options shared by sweep, tradeoff and extremes: lists of values, limits, SIGTERM."""

from __future__ import annotations

import argparse
import os
import signal
from typing import Any

from fem_snh.cli.options import SCENE_OPTIONS, Parser, assignments, value
from fem_snh.cli.run import scene_list
from fem_snh.errors import BadInput


def parser(command: str, description: str) -> Parser:
    """Return a parser with the options of a scene as comma lists, and the limits."""
    study_parser = Parser(command, description, scene_list)
    study_parser.add_argument(
        "scene", metavar="SCENE", help="a name, FILE.toml or FILE.py:FUNCTION"
    )
    for key, placeholder, help in SCENE_OPTIONS:
        study_parser.add_argument(f"--{key}", metavar=f"{placeholder},..", help=help)
    study_parser.add_argument(
        "--set",
        metavar="KEY=VALUE,..",
        action="append",
        default=[],
        help="any other key of the scene: angle=1,2",
    )
    add_limits(study_parser)
    return study_parser


def add_limits(
    parser: Parser, timeout: float | None = None, memory: float | None = None, jobs: int = 1
) -> None:
    """Add the options for processes and limits, with these defaults [s, GiB, points]."""
    jobs_help = f"number of points that run at a time; default: {jobs}"
    parser.add_argument("--jobs", metavar="J", default=jobs, type=value, help=jobs_help)
    parser.add_argument(
        "--ranks",
        metavar="R",
        default=1,
        type=value,
        help="number of MPI ranks of each point; default: 1",
    )
    for key, unit, most, help in (
        ("timeout", "S", timeout, "seconds after which a point is terminated"),
        ("memory", "GIB", memory, "memory above which a point is terminated"),
    ):
        default = f"; default: {most:g}" if most else ""
        parser.add_argument(f"--{key}", metavar=unit, type=value, default=most, help=help + default)
    parser.add_argument("--retry", action="store_true", help="run failed points again")
    parser.add_argument("--overwrite", action="store_true", help="discard the points in the folder")


def prepare_process(command: str) -> None:
    """Refuse to run under mpirun; turn SIGTERM, which batch systems send, into an interrupt."""
    if int(os.environ.get("OMPI_COMM_WORLD_SIZE", os.environ.get("PMI_SIZE", 1))) > 1:
        raise BadInput(f"{command} under mpirun: it starts the ranks itself; use --ranks R instead")
    signal.signal(signal.SIGTERM, signal.default_int_handler)


def axes(args: argparse.Namespace) -> dict[str, list[Any]]:
    """Return the list of values of each scene key on the command line."""
    given = {key: getattr(args, key) for key, _, _ in SCENE_OPTIONS}
    given = {key: text for key, text in given.items() if text is not None}
    return {key: comma_list(key, text) for key, text in (given | assignments(args.set)).items()}


def limits(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options of `add_limits` as keyword arguments of a study."""
    names = ("jobs", "ranks", "timeout", "memory", "retry", "overwrite")
    return {name: getattr(args, name) for name in names}


def comma_list(key: str, text: str) -> list[Any]:
    """Return the values of a comma list; commas inside brackets and quotes belong to a value."""
    parts, depth, quoted = [""], 0, ""
    for letter in text:
        if quoted:
            quoted = "" if letter == quoted else quoted
        elif letter in "\"'":
            quoted = letter
        depth += (letter in "[{") - (letter in "]}") if not quoted else 0
        if letter == "," and not depth and not quoted:
            parts.append("")
        else:
            parts[-1] += letter
    if not all(part.strip() for part in parts):
        raise BadInput(f"{key} = '{text}': expected values with commas between, e.g. 0.3,0.45")
    return [value(part.strip()) for part in parts]
