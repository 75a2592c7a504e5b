"""The command line ``python -m benchmarks NAME [--key value ...]``: one JSON line a row."""

from __future__ import annotations

import sys
from itertools import zip_longest

import benchmarks
from fem_snh.cli import exit_code
from fem_snh.cli.options import value
from fem_snh.errors import BadInput


def main(argv: list[str]) -> int:
    """Run one benchmark; 0 if every row that has "ok" is ok."""
    if not argv or {"-h", "--help"} & set(argv):
        print("python -m benchmarks NAME [--key value ...]\n\n" + (benchmarks.__doc__ or ""))
        return 0
    name, *words = argv
    options = {}
    for word, argument in zip_longest(words[::2], words[1::2]):
        if not word.startswith("--") or argument is None:
            raise BadInput(f"bench {name}: '{word}': expected pairs --key value")
        options[word.removeprefix("--")] = value(argument)
    return benchmarks.main(name, options)


if __name__ == "__main__":
    sys.exit(exit_code(main, sys.argv[1:]))
