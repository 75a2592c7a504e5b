"""Compile C once, into a cache that many ranks, jobs and machines may share.

The key holds the source, the compiler, its flags and the processor, so a home folder shared by
different nodes is safe; the library is moved into place in one step, so a reader sees all of it or
nothing.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import cffi

from fem_snh.errors import BadInput

#: No -ffast-math: NaN and infinity keep their meaning. errno and traps are nobody's concern here.
FLAGS = (
    "-O3 -march=native -std=gnu11 -fno-math-errno -fno-trapping-math -ffp-contract=fast "
    "-Wno-psabi -shared -fPIC"
).split()


def cache_folder() -> Path:
    """``$FEM_SNH_CACHE``, or ``fem_snh`` in the user's cache folder."""
    if own := os.environ.get("FEM_SNH_CACHE"):
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fem_snh"


def compiler() -> str:
    """The C compiler: ``$CC`` (which may hold options) or the first of gcc, clang, cc.

    Raises BadInput if there is none.
    """
    wanted = [os.environ["CC"]] if os.environ.get("CC", "").strip() else ["gcc", "clang", "cc"]
    for command in wanted:
        name, *options = shlex.split(command)
        if found := shutil.which(name):
            return shlex.join([found, *options])
    raise BadInput(f"no C compiler ({', '.join(wanted)}): install gcc, or set CC to one")


@lru_cache
def _environment(command: str) -> str:
    """What besides source and flags decides the machine code."""
    try:
        version = subprocess.run(
            [*shlex.split(command), "--version"], capture_output=True, text=True, check=True
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        raise BadInput(f"{command} is no C compiler: set CC to gcc or clang") from None
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        wanted = ("model name", "flags", "Features", "CPU part")
        cpu = sorted({x for x in lines if x.startswith(wanted)})
    except OSError:
        cpu = [platform.processor()]
    return "\n".join([command, version, platform.machine(), *cpu])


def library(source: str) -> Path:
    """The shared library made from ``source``, compiled if the cache does not have it.

    Raises BadInput if the cache cannot be written or the compiler fails.
    """
    command = compiler()
    key = hashlib.sha256("\n".join([source, *FLAGS, _environment(command)]).encode()).hexdigest()
    target = cache_folder() / f"{key[:24]}.so"
    try:
        if target.exists():
            return target
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix="build-") as folder:
            code, made = Path(folder, "kernel.c"), Path(folder, "kernel.so")
            code.write_text(source)
            done = subprocess.run(
                [*shlex.split(command), *FLAGS, str(code), "-o", str(made), "-lm"],
                capture_output=True,
                text=True,
            )
            if done.returncode:
                log = target.with_suffix(".log")
                log.write_text(done.stderr)
                raise BadInput(f"{command} could not compile a kernel: see {log}")
            os.replace(made, target)
    except OSError as error:
        raise BadInput(
            f"kernel cache {target.parent} cannot be written ({error.strerror}): "
            "set FEM_SNH_CACHE to a folder that can"
        ) from None
    return target


def load(path: Path, declarations: str) -> tuple[cffi.FFI, Any]:
    """Open a compiled library: ``(ffi, lib)``. Raises BadInput if the system will not have it."""
    ffi = cffi.FFI()
    ffi.cdef(declarations)
    try:
        return ffi, ffi.dlopen(str(path))
    except OSError as error:
        raise BadInput(
            f"kernel {path} cannot be opened ({error}): delete it, or set FEM_SNH_CACHE to a "
            "folder whose files may be executed"
        ) from None
