"""The command line ``python -m benchmarks NAME [--option value ...]``: one JSON line per row."""

from __future__ import annotations

import sys
from itertools import zip_longest

import benchmarks
from fem_snh.cli import exit_code
from fem_snh.cli.options import value
from fem_snh.errors import BadInput

_USAGE = """\
python -m benchmarks NAME [--option value ...]
python -m benchmarks NAME --help

Run a benchmark and print one JSON object per row. Exit code 1: a row misses its limit.
Lists are comma lists: --cells 8,12. A benchmark that runs scenes itself uses the ranks it is
started on: mpirun -n 2 python -m benchmarks twist.
"""


def main(argv: list[str]) -> int:
    """Run one benchmark; return 0 if every row that has ``ok`` is ok."""
    if not argv or argv[0] in ("-h", "--help"):
        print(f"{_USAGE}\n{benchmarks.help_text()}")
        return 0
    name, *arguments = argv
    if {"-h", "--help"} & set(arguments):
        print(benchmarks.help_text(name))
        return 0
    options = {}
    for option, argument in zip_longest(arguments[::2], arguments[1::2]):
        if not option.startswith("--") or argument is None:
            raise BadInput(f"benchmark {name}: '{option}': expected pairs --option value")
        options[option.removeprefix("--")] = value(argument)
    return benchmarks.main(name, options)


if __name__ == "__main__":
    sys.exit(exit_code(main, sys.argv[1:]))
