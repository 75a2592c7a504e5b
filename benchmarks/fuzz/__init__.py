"""Fuzz the program: random input gives the known answer, and damaged input ends well.

A family (`benchmarks.fuzz.family`) makes inputs of one kind from seeds: files in an empty folder,
and a command line. Two of three are valid, and their answer is known: constants of a fit, the
reaction of a support, a distance, the same numbers in other units. The others are damaged in one
place. Each case runs in a process of its own, with limits of time. It passes if the program

- succeeds (exit code 0) without a traceback, with the answer where it is known;
- or keeps a result that did not converge (exit code 1, with a run.json);
- or refuses the input (exit code 2) with exactly one line on standard error;

and if no file of the user has been removed or changed. A signal, a traceback, a hang and any other
exit code are failures. The same seed makes the same case everywhere: ``--only mesh --seed 17
--count 1 --out DIR`` repeats one case and keeps its files.

To add a family: a module here with a dict ``FAMILIES`` of `Family`, named in `MODULES`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks import Row, page_tables, search_path, split_list
from benchmarks.fuzz.family import load_families
from fem_snh.errors import choose
from fem_snh.studies.tasks import environment

#: Messages of failures that a row shows.
_SHOWN = 10


def rows(
    only: str = "", count: int = 300, seed: int = 0, out: str = "", write: str = ""
) -> Iterator[Row]:
    """Run the cases of each family and yield one row per family.

    Parameters
    ----------
    only : str
        Comma list of families; default: all.
    count : int
        Cases of each family, with the seeds from ``seed`` on.
    seed : int
        The first seed.
    out : str
        A folder that keeps the input and the output of the cases that fail; default: none.
    write : str
        A page whose table is replaced by these rows: docs/results/fuzz.md.

    Yields
    ------
    dict
        ``family``, ``description``, ``cases``; ``converged``, ``unconverged``, ``refused``: the
        numbers of cases with exit code 0, 1 and 2; ``valid``, the share of the first; ``failed``,
        the number of failures, and ``failures``, the seed and the reason of the first ten; ``ok``
        if there are none.
    """
    families = load_families()
    names = [choose("family", name, families) for name in split_list(only)] or list(families)
    parts = page_tables.split_page(Path(write), "fuzz") if write else ("", "")
    done = []
    for name in names:
        description = (families[name].make.__doc__ or "").strip().partition("\n")[0]
        done.append({"family": name, "description": description} | _row(name, seed, count, out))
        yield done[-1]
    if write:
        page_tables.write_table(Path(write), "fuzz", parts, table(done))


def _row(name: str, seed: int, count: int, out: str) -> Row:
    """Return what became of the cases of a family."""
    cases = list(run_cases(name, range(seed, seed + count), out))
    failures = [{"seed": c["seed"], "failure": c["failure"]} for c in cases if c["failure"]]
    codes = Counter(case["code"] for case in cases if not case["failure"])
    return {
        "cases": len(cases),
        "converged": codes[0],
        "unconverged": codes[1],
        "refused": codes[2],
        "valid": round(codes[0] / (len(cases) or 1), 2),
        "failed": len(failures),
        "failures": failures[:_SHOWN],
        "ok": not failures and len(cases) == count,
    }


def run_cases(name: str, seeds: range, out: str = "") -> Iterator[dict[str, Any]]:
    """Yield the outcome of each case of a family.

    Yields
    ------
    dict
        ``seed``; ``code``, the exit code, or None; ``failure``, the reason why the case failed, or
        an empty text; ``message``, the last line on standard error.
    """
    with tempfile.TemporaryDirectory(prefix="fem-snh-fuzz-") as folder:
        command = [sys.executable, "-m", "benchmarks.fuzz.worker"]
        arguments = [name, str(seeds.start), str(seeds.stop), out or folder]
        worker = subprocess.Popen(
            [*command, *arguments, *(["keep"] if out else [])],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            env=environment() | search_path(),
            text=True,
        )
        try:
            assert worker.stdout
            with worker.stdout as lines:
                yield from map(json.loads, lines)
        finally:
            worker.kill()
            worker.wait()


def table(found: list[Row]) -> str:
    """Return the rows as a Markdown table."""
    keys = "family description cases converged unconverged refused valid failed".split()
    return page_tables.markdown_table(keys, [[str(row[key]) for key in keys] for row in found])
