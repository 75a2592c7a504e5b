"""The command ``extremes``: test the robustness of materials and solver."""

from __future__ import annotations

from pathlib import Path

from fem_snh.cli import study_options
from fem_snh.cli.options import Parser, output, value

#: Defaults: cases that run at a time, and the limits of each [s, GiB].
JOBS, TIMEOUT, MEMORY = 2, 900.0, 3.0


def extremes_parser() -> Parser:
    """Return the parser of ``fem-snh extremes``."""
    from fem_snh.studies.extremes import FAMILIES

    parser = Parser(
        "extremes",
        "Run scrambled, crushed and overloaded bodies, each case in its own process, and write a\n"
        "table and a page with pictures. An interrupted study continues.\n"
        f"Families: {', '.join(FAMILIES)}.",
    )
    parser.add_argument("--only", metavar="FAMILY,..", help="families of cases; default: all")
    parser.add_argument(
        "--quick", action="store_true", help="run a few small cases only, in minutes"
    )
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=value,
        default=100,
        help="random scrambles of each small cube; default: 100",
    )
    parser.add_argument(
        "--material",
        metavar="NAME|FILE.py:NAME",
        default="",
        help="test this material, e.g. one of your own; default: all pointwise, Stable Neo-Hookean",
    )
    parser.add_argument(
        "--out", metavar="DIR", type=output, default=Path("out/extremes"), help="the study's folder"
    )
    study_options.add_limits(parser, TIMEOUT, MEMORY, JOBS)
    return parser


def extremes(argv: list[str]) -> int:
    """Run the cases; return 0 if all required criteria are met, else 1."""
    parser = extremes_parser()
    args = parser.parse(argv)
    study_options.prepare_process("extremes")

    from fem_snh.studies.extremes.study import extremes as study

    only = study_options.comma_list("only", args.only) if args.only is not None else []
    outcome = study(
        args.out,
        only=only,
        quick=args.quick,
        seeds=args.seeds,
        material=args.material,
        **study_options.limits(args),
    )
    failures = outcome.failures
    for criterion, reason in failures.items():
        print(f"failed: {criterion}: {reason}")
    passed = outcome.required - len(failures)
    print(f"{passed} of {outcome.required} that are expected to pass do: {args.out}")
    return 1 if failures else 0
