"""``fem-snh sweep``: every comma list of values is an axis."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

from fem_snh.cli.options import SCENE_OPTIONS, Parser, assignments, split_petsc, value
from fem_snh.cli.run import scene_list
from fem_snh.errors import BadInput


def sweep(argv: list[str]) -> int:
    """Solve every point; 0 if all of them converged, 1 if not."""
    parser = Parser(
        "sweep",
        "Solve a scene for every combination of values, each in a process of its own.\n"
        "Every option of a scene takes a comma list: --nu 0.3,0.45 --material a,b --set angle=1,2",
        scene_list(),
    )
    parser.add_argument("scene", metavar="SCENE|FILE.toml")
    for key, placeholder, help in SCENE_OPTIONS:
        parser.add_argument(f"--{key}", metavar=f"{placeholder},..", help=help)
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE,..",
        action="append",
        default=[],
        help="any other key of the scene: angle=1,2",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="the sweep's folder")
    parser.add_argument("--jobs", metavar="J", default=1, type=value, help="points at a time")
    parser.add_argument(
        "--ranks", metavar="R", default=1, type=value, help="MPI ranks of each point"
    )
    parser.add_argument(
        "--timeout", metavar="S", type=value, help="seconds after which a point is given up"
    )
    parser.add_argument("--retry", action="store_true", help="run failed points again")
    parser.add_argument("--overwrite", action="store_true", help="begin anew")
    if int(os.environ.get("OMPI_COMM_WORLD_SIZE", os.environ.get("PMI_SIZE", 1))) > 1:
        raise BadInput("sweep under mpirun: it starts the ranks itself; use --ranks R instead")
    words, petsc = split_petsc(argv)
    args = parser.parse(words)
    given = {key: getattr(args, key) for key, _, _ in SCENE_OPTIONS if getattr(args, key)}
    axes = {key: axis(key, text) for key, text in (given | assignments(args.set)).items()}

    from fem_snh.studies.sweep import sweep as study

    # A batch system asks to end with SIGTERM: end the points too.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    table = study(
        args.scene,
        args.out,
        axes,
        jobs=args.jobs,
        ranks=args.ranks,
        timeout=args.timeout,
        retry=args.retry,
        overwrite=args.overwrite,
        petsc=petsc,
    )
    good = int(table["converged"].sum())
    print(f"{good} of {len(table)} points converged: {args.out / 'sweep.csv'}")
    return 0 if good == len(table) else 1


def axis(key: str, text: str) -> list[Any]:
    """The values of a comma list; commas inside brackets and quotes belong to a value."""
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
