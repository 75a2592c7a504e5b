"""The command ``sweep``: solve a scene for every combination of lists of values."""

from __future__ import annotations

from fem_snh.cli import study_options
from fem_snh.cli.options import Parser, output, split_petsc


def sweep_parser() -> Parser:
    """Return the parser of ``fem-snh sweep``."""
    parser = study_options.parser(
        "sweep",
        "Solve a scene for every combination of values, --jobs of them at a time.\n"
        "Every option of a scene takes a comma list: --nu 0.3,0.45 --material a,b --set angle=1,2",
    )
    parser.add_argument(
        "--out", metavar="DIR", type=output, required=True, help="the sweep's folder"
    )
    parser.add_argument(
        "--render",
        metavar="FIELD",
        nargs="?",
        const="J",
        help="also draw the bodies of all points in one picture, bodies.png, with the colours of a "
        "field; default: J",
    )
    return parser


def sweep(argv: list[str]) -> int:
    """Solve every point; return 0 if all converged, else 1."""
    parser = sweep_parser()
    words, petsc = split_petsc(argv)
    args = parser.parse(words)
    study_options.prepare_process("sweep")
    axes = study_options.axes(args)

    from fem_snh.studies.sweep import sweep as study
    from fem_snh.studies.table import NO_NOTES

    limits = study_options.limits(args)
    table = study(args.scene, args.out, axes, petsc=petsc, render=args.render, **limits)
    good = int(table["converged"].sum())
    noted = int(table["notes"].ne(NO_NOTES).sum())
    remark = f", {noted} with notes" if noted else ""
    print(f"{good} of {len(table)} points converged{remark}: {args.out / 'sweep.csv'}")
    return 0 if good == len(table) else 1
