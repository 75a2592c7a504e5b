"""The command ``materials``: list materials, describe one, report its behaviour, compare them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from fem_snh.cli.options import REPEATED, Parser, material_values, output, value, with_settings
from fem_snh.errors import BadInput
from fem_snh.materials import defaults, describe, make_energy, names

EPILOG = """\
fem-snh materials                                  list all materials
fem-snh materials NAME                             its energy density, source and parameters
fem-snh materials NAME --report --nu 0.3           stability, admissible region, stress curves
fem-snh materials NAME --plot a.png --set alpha=2  the report as a picture
fem-snh materials NAME --source                    the generated C of its kernels
fem-snh materials --table --csv table.csv          compare the stability of all materials
fem-snh materials gent.py:gent --report            a function gent in a file of your own
"""


def materials_parser() -> Parser:
    """Return the parser of ``fem-snh materials``."""
    return Parser(
        "materials",
        "List the materials, describe one, or report how it behaves.",
        """
        names NAME  a material, or FILE.py:FUNCTION of your own
        --E X  Young's modulus [Pa] (default: 1)
        --nu X  Poisson's ratio, in (-1, 0.5) (default: 0.49)
        --set KEY=VALUE  a shape parameter or a tuning parameter (alpha, lambda_part, ...)
        --report  print stability, admissible region, stress curves
        --plot PNG  draw the report
        --source  print the generated C
        --table  compare the stability of NAME ... or of all materials
        --csv FILE  also write the table to FILE
        --overwrite  replace FILE
        """,
        lambda: EPILOG,
        names={"nargs": "*"},
        E=value,
        nu=value,
        set=REPEATED,
        plot={"nargs": "?", "const": ""},
        csv=output,
    )


def materials(argv: list[str]) -> int:
    """List the materials, describe one, or report its behaviour; return 0."""
    args = materials_parser().parse(argv)
    numbers = with_settings({"E": args.E, "nu": args.nu}, material_values(args.set))
    if args.table:
        return _table(args.names, args.csv, args.overwrite, numbers)
    if len(args.names) > 1:
        raise BadInput(
            f"materials: unexpected '{args.names[1]}': expected one name, or --table to compare"
        )
    one = args.report or args.plot is not None or args.source
    if one and not args.names:
        raise BadInput("materials: missing NAME: expected with --report, --plot and --source")
    if not args.names:
        return _list()
    name = args.names[0]
    if not one:
        print(describe(name))
        return 0
    if args.source:
        from fem_snh.kernels.codegen.source import material_source

        print(material_source(make_energy(name, **numbers)))
    if not (args.report or args.plot is not None):
        return 0
    from fem_snh.kernels.material import material

    report = material(name, **numbers).report()
    if args.report:
        print(report)
    if args.plot is not None:
        stem = name.rpartition(":")[2]  # of FILE.py:FUNCTION, the function
        print(report.plot(Path(args.plot or f"{stem}.png")))
    return 0


def _list() -> int:
    """Print all materials with their energy densities and shape parameters."""
    rows = []
    for name in names():
        try:
            title, *body = describe(name).split("\n\n")
            parameters = [f"{key} = {default}" for key, default in defaults(name).items()]
        except BadInput as error:  # of an entry point; it must not hide the other materials
            rows.append((name, str(error), "-"))
            continue
        shown = [title, *(part for part in body if "psi =" in part)]
        rows.append((name, "\n".join(shown), "\n".join(parameters) or "-"))
    heading = ("material", "energy density and source", "shape parameters")
    print_table(heading, rows, show_lines=True)
    print(
        "Every material takes --E [Pa] and --nu; all agree at small strain. "
        "`fem-snh materials NAME` describes one, NAME --report reports its stability, --table "
        "compares them."
    )
    return 0


def _table(
    names: Sequence[str], path: Path | None, overwrite: bool, numbers: dict[str, Any]
) -> int:
    """Print the table of the materials ``names``, of all if empty, and write it to ``path``."""
    if path is not None and path.exists() and not overwrite:
        raise BadInput(f"csv = {path}: exists: expected another file, or --overwrite")
    from fem_snh.kernels.reports.report import rows, write

    verdicts = []
    with Console(stderr=True).status("compiling and evaluating") as status:
        for row in rows(*names, **numbers):
            verdicts.append(row)
            status.update(f"compiling and evaluating: {row['name']}")
    if path is not None:
        write(path, verdicts)
    four = ("inversion", "reflection", "rest", "degeneracy")
    cells = [
        (
            row["name"] + (f"\n({row['note']})" if row["note"] else ""),
            *(f"{row[key]:.4g}" for key in ("mu_lame", "lambda_lame")),
            *(_verdict(row[key], row[f"{key}_reason"]) for key in four),
            row["domain"],
            "yes" if row["stretches"] else "no",
        )
        if row["inversion"]
        else (row["name"], *["-"] * 6, row["note"])
        for row in verdicts
    ]
    print_table(("material", "mu", "lambda", *four, "finite for", "SVD"), cells, width=180)
    print("`fem-snh materials NAME --report` prints the numbers behind each verdict.")
    return 0


def _verdict(verdict: str, reason: str) -> str:
    """Return the text of a table cell, with the reason of a failure."""
    if verdict == "not applicable":
        return "n/a"
    return verdict if verdict == "passed" else f"failed: {reason}"


def print_table(
    columns: Iterable[str], rows: Iterable[Iterable[str]], width: int = 110, **settings: Any
) -> None:
    """Print a table; ``width`` is its width in columns where standard output is no terminal."""
    table = Table(*columns, **settings)
    table.columns[0].no_wrap = True
    for row in rows:
        table.add_row(*map(Text, row))  # brackets in a text are no markup
    Console(width=None if sys.stdout.isatty() else width).print(table)
