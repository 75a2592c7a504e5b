"""The command ``materials``: list them, describe one, measure what it is like, compare them all."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from fem_snh.cli.options import Parser, assignments, value
from fem_snh.errors import BadInput

EPILOG = """\
fem-snh materials                                  the list
fem-snh materials NAME                             its equation, source and parameters
fem-snh materials NAME --report --nu 0.3           what it is like, measured
fem-snh materials NAME --plot a.png --set alpha=2  the same as a picture
fem-snh materials --table --csv table.csv          the stabilities of all
"""


def materials(argv: list[str]) -> int:
    """List the materials, or describe one."""
    parser = Parser("materials", "List the materials, describe one, or measure them.", EPILOG)
    parser.add_argument("name", metavar="NAME", nargs="?")
    parser.add_argument("--E", metavar="X", help="Young's modulus [Pa] (default: 1)")
    parser.add_argument("--nu", metavar="X", help="Poisson's ratio, in (-1, 0.5) (default: 0.49)")
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="a shape parameter or tuning",
    )
    parser.add_argument("--report", action="store_true", help="what NAME is like, measured")
    parser.add_argument("--plot", metavar="PNG", nargs="?", const="", help="the same, drawn")
    parser.add_argument("--table", action="store_true", help="the stabilities of all materials")
    parser.add_argument("--csv", metavar="FILE", type=Path, help="the table as a file, too")
    args = parser.parse(argv)
    numbers = _numbers(args)
    if args.csv is not None and not args.table:
        raise BadInput("materials --csv: only with --table")
    if args.table:
        if args.name is not None or args.report or args.plot is not None:
            raise BadInput("materials --table: of all materials, without NAME, --report or --plot")
        return _table(args.csv, numbers)
    measured = args.report or args.plot is not None
    if args.name is None and measured:
        raise BadInput("materials: which one? give NAME, or --table for all")
    if numbers and not measured:
        raise BadInput(
            "materials --E, --nu, --set: only with NAME --report, NAME --plot or --table"
        )
    if args.name is None:
        return _list()
    return _measure(args, numbers) if measured else _describe(args.name)


def _numbers(args: Namespace) -> dict[str, Any]:
    """The keywords for `material` that were given: E, nu, and those of --set."""
    found: dict[str, Any] = {}
    for key in ("E", "nu"):
        text = getattr(args, key)
        if text is not None:
            found[key] = value(text)
            if isinstance(found[key], bool) or not isinstance(found[key], int | float):
                raise BadInput(f"{key} = {text!r}: expected a number")
    for key, text in assignments(args.set).items():  # as for run: material.alpha=2
        found[key.removeprefix("material.")] = value(text)
    return found


def _list() -> int:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from fem_snh.materials import defaults, describe, names

    table = Table("material", "energy density and source", "shape parameters", show_lines=True)
    for name in names():
        title, *body = describe(name).split("\n\n")
        shown = [title, *(part for part in body if "psi =" in part)]
        own = [f"{key} = {default}" for key, default in defaults(name).items()]
        table.add_row(name, Text("\n".join(shown)), Text("\n".join(own) or "-"))
    Console(width=None if sys.stdout.isatty() else 110).print(table)
    print(
        "All take --E [Pa] and --nu, and agree at small strain; `fem-snh materials NAME` says "
        "more, NAME --report measures it, --table compares them all."
    )
    return 0


def _describe(name: str) -> int:
    from fem_snh.materials import describe

    print(describe(name))
    return 0


def _measure(args: Namespace, numbers: dict[str, Any]) -> int:
    from fem_snh.kernels.pointwise import material

    found = material(args.name, **numbers).report()
    if args.report:
        print(found)
    if args.plot is not None:
        print(found.plot(Path(args.plot or f"{args.name}.png")))
    return 0


def _table(path: Path | None, numbers: dict[str, Any]) -> int:
    from rich.console import Console
    from rich.table import Table

    from fem_snh.reports.table import rows, write

    found = []
    with Console(stderr=True).status("compiling and measuring") as status:
        for row in rows(**numbers):
            found.append(row)
            status.update(f"compiling and measuring: {row['name']}")
    if path is not None:
        write(path, found)
    four = ("inversion", "reflection", "rest", "degeneracy")
    table = Table("material", "mu", "lambda", *four, "minima", "finite for", "SVD")
    table.columns[0].no_wrap = True
    for row in found:
        if not row["inversion"]:
            table.add_row(row["name"], *["-"] * 6, row["note"])
            continue
        table.add_row(
            row["name"] + (f"\n({row['note']})" if row["note"] else ""),
            *(f"{row[key]:.4g}" for key in ("mu_lame", "lambda_lame")),
            *(_verdict(row[key], row[f"{key}_why"]) for key in four),
            row["minima"],
            row["domain"],
            "yes" if row["stretches"] else "no",
        )
    Console(width=None if sys.stdout.isatty() else 180).print(table)
    print("`fem-snh materials NAME --report` has the numbers behind each verdict.")
    return 0


def _verdict(verdict: str, why: str) -> str:
    if verdict == "not applicable":
        return "n/a"
    return verdict if verdict == "holds" else f"fails: {why}"
