"""The command ``export``."""

from __future__ import annotations

from pathlib import Path

from fem_snh.cli.options import Parser, output
from fem_snh.cli.progress_bar import progress_bar


def export_parser() -> Parser:
    """Return the parser of ``fem-snh export``."""
    parser = Parser(
        "export",
        "Write all stored loads of a run into one VTKHDF file for ParaView, with the load as time, "
        "or the deformed surface as a sequence of OBJ files or as one USD file.",
    )
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of a run")
    parser.add_argument(
        "out",
        metavar="OUT",
        type=output,
        help="NAME.vtkhdf: one file; NAME.obj: files NAME_0000.obj, NAME_0001.obj, ...; "
        "NAME.usd: one file (needs fem_snh[usd])",
    )
    parser.add_argument(
        "--frames",
        metavar="N",
        type=int,
        help="number of OBJ files, interpolated evenly over the load; default: the stored loads",
    )
    parser.add_argument(
        "--field", metavar="NAME", help="field that colours the vertices of OBJ and USD files"
    )
    return parser


def export(argv: list[str]) -> int:
    """Write a run's states in another format, with a progress bar. Return 0."""
    args = export_parser().parse(argv)

    from fem_snh.viewing.export import main

    with progress_bar("writing") as report:
        paths = main(args.folder, args.out, args.frames, report, args.field)
    print(paths[0] if len(paths) == 1 else f"{paths[0]} ... {paths[-1].name}")
    return 0
