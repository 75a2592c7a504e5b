"""The small commands: materials, plot, render, bench, doctor."""

from __future__ import annotations

import sys
from itertools import zip_longest
from pathlib import Path

from fem_snh.cli.options import Parser, value
from fem_snh.errors import BadInput


def materials(argv: list[str]) -> int:
    """List the materials, or describe one."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from fem_snh.materials import defaults, describe, names

    parser = Parser("materials", "List the materials, or describe one.")
    parser.add_argument("name", metavar="NAME", nargs="?")
    name = parser.parse(argv).name
    if name is not None:
        print(describe(name))
        return 0
    table = Table("material", "energy density and source", "shape parameters", show_lines=True)
    for name in names():
        title, *body = describe(name).split("\n\n")
        shown = [title, *(part for part in body if "psi =" in part)]
        own = [f"{key} = {default}" for key, default in defaults(name).items()]
        table.add_row(name, Text("\n".join(shown)), Text("\n".join(own) or "-"))
    Console(width=None if sys.stdout.isatty() else 110).print(table)
    print(
        "All take --E [Pa] and --nu, and agree at small strain; `fem-snh materials NAME` says more."
    )
    return 0


def plot(argv: list[str]) -> int:
    """Curves from run folders or a sweep's table."""
    parser = Parser("plot", "Curves from run folders (one line each) or from a sweep's table.")
    parser.add_argument("paths", metavar="DIR|SWEEP.csv", nargs="+", type=Path)
    parser.add_argument("--out", metavar="PNG", type=Path)
    parser.add_argument("--newton", action="store_true", help="Newton iterations as well")
    args = parser.parse(argv)

    from fem_snh.plots import main

    print(main(args.paths, args.out, args.newton))
    return 0


def render(argv: list[str]) -> int:
    """A picture of the deformed body of a run folder."""
    parser = Parser("render", "Draw the deformed body of a run folder, one panel per load.")
    parser.add_argument("folder", metavar="DIR", type=Path)
    parser.add_argument("--out", metavar="PNG", type=Path)
    parser.add_argument("--loads", metavar="T,T", help="loads between 0 and 1, e.g. 0.5,1")
    parser.add_argument("--field", metavar="NAME", default="J", help="the colour (default: J)")
    args = parser.parse(argv)
    loads = None
    if args.loads is not None:
        loads = [value(word) for word in args.loads.split(",")]
        if not all(isinstance(load, int | float) for load in loads):
            raise BadInput(f"--loads {args.loads}: expected numbers between 0 and 1, e.g. 0.5,1")

    from fem_snh.render import main

    print(main(args.folder, args.out, loads, args.field))
    return 0


def bench(argv: list[str]) -> int:
    """Measure something, one JSON line at a time."""
    from fem_snh.studies import bench as benches

    if not argv or {"-h", "--help"} & set(argv):
        print("fem-snh bench NAME [--key value ...]\n\n" + (benches.__doc__ or ""))
        return 0
    name, *words = argv
    options = {}
    for word, argument in zip_longest(words[::2], words[1::2]):
        if not word.startswith("--") or argument is None:
            raise BadInput(f"bench {name}: '{word}': expected pairs --key value")
        options[word.removeprefix("--")] = value(argument)
    return benches.main(name, options) or 0


def doctor(argv: list[str]) -> int:
    """Say whether this machine has what it takes."""
    Parser("doctor", "Say whether this machine has what it takes.").parse(argv)

    from fem_snh.doctor import main

    return main() or 0
