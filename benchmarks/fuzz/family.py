"""Families of cases, and how a case is made, run and judged."""

from __future__ import annotations

import faulthandler
import hashlib
import os
import resource
import shutil
import signal
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

from fem_snh import cli

#: Modules of `benchmarks.fuzz` that define families.
MODULES = ("meshes", "surfaces", "motions", "fits", "scenes", "commands")
#: Limits of a case's processor time and elapsed time [s]; a case takes a second or two.
_PROCESSOR, _ELAPSED = 60, 300
#: Where a case is made and run: its input, and what the program printed.
_INPUT, _STDOUT, _STDERR = "input", "stdout.txt", "stderr.txt"


@dataclass(frozen=True)
class Family:
    """Inputs of one kind.

    Attributes
    ----------
    make : callable
        ``make(random, folder)`` writes the files of a case into the empty folder and returns the
        arguments of the command. The working directory of the command is that folder. The first
        line of its docstring describes the family.
    main : callable
        ``main(arguments)`` runs the command and returns its exit code; default: ``fem-snh``. A
        family of files that needs no whole run gives a function that reads them, and raises
        AssertionError for a file that is read but makes no sense.
    preload : tuple of str
        Modules to import once: each case runs in a fork of the process that has imported them.
    out : str
        The folder of the result of a run, by which exit code 1 is judged: run.json must be in it.
    """

    make: Callable[[Random, Path], list[str]]
    main: Callable[[list[str]], int] = cli.main
    preload: tuple[str, ...] = ()
    out: str = "out"


def load_families() -> dict[str, Family]:
    """Return all families by name."""
    found: dict[str, Family] = {}
    for name in MODULES:
        found |= import_module(f"benchmarks.fuzz.{name}").FAMILIES
    return found


def run_case(name: str, family: Family, seed: int, folder: Path) -> dict[str, Any]:
    """Make the case of a seed in a new folder, run it in a fork of this process, and judge it."""
    where = folder / f"{name}-{seed}"
    shutil.rmtree(where, ignore_errors=True)
    (where / _INPUT).mkdir(parents=True)
    arguments = family.make(Random(f"{name} {seed}"), where / _INPUT)
    (where / "arguments.txt").write_text("\n".join(arguments), encoding="utf-8", errors="replace")
    before = _digests(where / _INPUT)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", DeprecationWarning
        )  # of BLAS's threads, which wait for work
        child = os.fork()
    if child == 0:
        _run(family, arguments, where)  # does not return
    code = _wait(child)
    stderr = (where / _STDERR).read_text(errors="replace") if (where / _STDERR).exists() else ""
    kept = (where / _INPUT / family.out / "run.json").exists()
    failure = judge(code, stderr, kept) or _changed(before, _digests(where / _INPUT))
    lines = stderr.strip().splitlines()
    return {"seed": seed, "code": code, "failure": failure, "message": lines[-1] if lines else ""}


def judge(code: int | None, stderr: str, kept: bool) -> str:
    """Return why an outcome is a failure; an empty text if it is none.

    Parameters
    ----------
    code : int or None
        The exit code, minus the number of the signal that ended the process, or None if it hung.
    stderr : str
        What it printed on standard error.
    kept : bool
        Whether it has left a run.json.
    """
    lines = stderr.strip().splitlines()
    if code is None or code == -signal.SIGXCPU:
        return "hang"
    if code < 0:
        return f"signal {signal.Signals(-code).name}"
    if any(line.startswith("Traceback") for line in lines):
        return f"traceback: {lines[-1]}"
    if code == 1:
        return "" if kept else "exit code 1 without a result"
    if code == 2:
        return "" if len(lines) == 1 else f"exit code 2 with {len(lines)} lines on standard error"
    return "" if code == 0 else f"exit code {code}"


def _digests(folder: Path) -> dict[str, str]:
    """Return a digest of each regular file of a folder, by its path."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _changed(before: dict[str, str], after: dict[str, str]) -> str:
    """Return which file has been removed or changed."""
    for path, digest in before.items():
        if after.get(path) != digest:
            return f"{path} was {'changed' if path in after else 'removed'}"
    return ""


def _run(family: Family, arguments: list[str], where: Path) -> None:
    """Run a case in this process, a child, and end it."""
    code = 70  # of an exception that `exit_code` lets through
    try:
        faulthandler.disable()  # pytest's prints to its own terminal
        os.setsid()  # its own children end with it
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (_PROCESSOR, _PROCESSOR + 5))
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for number, name in ((1, _STDOUT), (2, _STDERR)):
            os.dup2(os.open(where / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666), number)
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", 1, closefd=False)
        os.chdir(where / _INPUT)
        code = cli.exit_code(family.main, arguments)
        sys.stdout.flush()
    finally:
        os._exit(code)


def _wait(child: int) -> int | None:
    """Return the exit code of a case's process, or None if it does not end in time."""
    deadline = time.monotonic() + _ELAPSED
    code = None
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            code = os.waitstatus_to_exitcode(status)
            break
        time.sleep(0.002)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if code is None:
        with suppress(ChildProcessError):
            os.waitpid(child, 0)
    return code
