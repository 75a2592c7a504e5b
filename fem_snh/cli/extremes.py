"""``fem-snh extremes``: what the material and the solver survive."""

from __future__ import annotations

from pathlib import Path

from fem_snh.cli import campaign
from fem_snh.cli.options import Parser, value

#: Cases at a time, and the seconds and GiB that each may take, if nothing else is said.
JOBS, TIMEOUT, MEMORY = 2, 900.0, 3.0


def extremes(argv: list[str]) -> int:
    """Run the cases; 0 if every one that must hold does, 1 if not."""
    from fem_snh.studies.extremes import FAMILIES

    parser = Parser(
        "extremes",
        "Run what must not break, each case in a process of its own, and write a table and a page\n"
        f"with pictures. Families: {', '.join(FAMILIES)}. It goes on where it was ended.",
    )
    parser.add_argument("--only", metavar="FAMILY,..", help="these families; default: all")
    parser.add_argument("--quick", action="store_true", help="a few small cases, in minutes")
    parser.add_argument(
        "--seeds", metavar="N", type=value, default=100, help="scrambles of each small cube"
    )
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("out/extremes"), help="the study's folder"
    )
    campaign.add_limits(parser, TIMEOUT, MEMORY, JOBS)
    args = parser.parse(argv)
    campaign.begin("extremes")

    from fem_snh.studies.extremes.study import extremes as study

    only = campaign.axis("only", args.only) if args.only else []
    outcome = study(
        args.out, only=only, quick=args.quick, seeds=args.seeds, **campaign.limits(args)
    )
    failures = outcome.failures
    for asked, why in failures.items():
        print(f"does not hold: {asked}: {why}")
    must = int(outcome.table["must"].sum()) + len(outcome.demands)
    print(f"{must - len(failures)} of {must} that must hold do: {args.out}")
    return 1 if failures else 0
