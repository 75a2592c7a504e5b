"""Check the installation: quickly before a solve, and in detail for `fem-snh doctor`.

This module imports only the standard library and fem_snh.errors, so that it works where other
packages are missing. Each row of the table comes from a separate process, because a broken MPI or
VTK ends its process instead of raising an exception.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

from fem_snh.errors import BadInput

SETUP = "run `make setup` in the repository, then its .venv/bin/fem-snh"
#: Packages that a solve imports; pictures and sweeps import theirs when they need them.
NEEDED = "numpy cffi pydantic mpi4py petsc4py basix ufl ffcx dolfinx".split()
#: Packages that only some solves import: gmsh for a built-in geometry, sympy if a kernel is
#: generated, scipy for contact.
FOUND = "gmsh scipy sympy".split()
#: Packages that pip installs (pyproject.toml), besides pyvista, which has its own row.
PACKAGES = "cffi numpy pandas platformdirs psutil pydantic rich scipy sympy matplotlib".split()


def check() -> None:
    """Raise BadInput if a package that a solve needs is missing or PETSc has complex numbers.

    It imports only packages that a solve imports anyway, so it costs no time. Each rank has the
    same outcome.
    """
    for name in NEEDED:
        try:
            import_module(name)
        except Exception as error:  # also a library that is missing, or numpy's ABI: ValueError
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise BadInput(f"{sys.executable} cannot import {name} ({reason}): {SETUP}") from None
    for name in FOUND:
        if find_spec(name) is None:
            raise BadInput(f"{sys.executable} cannot import {name} (no such package): {SETUP}")
    from petsc4py import PETSc

    if PETSc.ScalarType().dtype.kind != "f":
        raise BadInput(
            "this PETSc computes with complex numbers: install python3-dolfinx-real and unset "
            "PETSC_DIR, or set it to a PETSc of real numbers"
        )


@dataclass(frozen=True)
class Finding:
    """A row of the table: the component, its state (ok, slow or missing), its version, a remedy."""

    what: str
    state: str
    found: str
    remedy: str = ""


def _environment() -> dict[str, str]:
    """Return the environment without an MPI launcher's variables, for a child of its own."""
    prefixes = ("OMPI_COMM_", "OMPI_UNIVERSE", "OMPI_FIRST", "PMIX_", "PMI_")
    return {k: v for k, v in os.environ.items() if not k.startswith(prefixes)}


def _run(command: list[str], timeout: float = 60.0, reason: int = -1) -> tuple[bool, str]:
    """Run a command; return whether it succeeded, and the last line of its output.

    If it failed, it is the line number ``reason`` instead: Python's last one, mpirun's first one.
    """
    try:
        done = subprocess.run(
            command,
            env=_environment(),
            capture_output=True,
            text=True,
            timeout=timeout,
            stdin=subprocess.DEVNULL,
        )
    except FileNotFoundError:
        return False, f"no {command[0]} on the PATH"
    except subprocess.TimeoutExpired:
        return False, f"no answer in {timeout:g} s"
    ok = done.returncode == 0
    lines = (done.stdout if ok else done.stderr or done.stdout).splitlines()
    words = [line for line in lines if re.search(r"\w", line)]  # Open MPI ends with a rule
    line = words[-1 if ok else reason].strip() if words else f"exit code {done.returncode}"
    return ok, line if ok else re.sub(r"^[\w.]*(Error|BadInput): ", "", line)


def _probe(what: str, code: str, remedy: str) -> Callable[[], Finding]:
    """Return a function that makes a row by a Python program which prints a version."""

    def find() -> Finding:
        ok, found = _run([sys.executable, "-c", code])
        return Finding(what, "ok" if ok else "missing", found, "" if ok else remedy)

    return find


def _python() -> Finding:
    """Return the row of Python."""
    version = ".".join(map(str, sys.version_info[:3]))
    ok = sys.version_info >= (3, 11)
    return Finding(
        "Python",
        "ok" if ok else "missing",
        f"{version}, {sys.executable}",
        "" if ok else f"3.11 or newer is needed: {SETUP}",
    )


def _blas() -> Finding:
    """Return the row of PETSc's BLAS: direct solvers are ten times slower on the reference one."""
    code = (
        "from petsc4py import PETSc\nimport re\n"
        "maps = {l.split()[-1] for l in open('/proc/self/maps')}\n"
        "names = [m for m in sorted(maps) if re.search(r'blas|mkl_rt|blis|flexiblas|atlas', m)]\n"
        "print(next((n for n in names if 'gsl' not in n), 'unknown'))"
    )
    ok, found = _run([sys.executable, "-c", code])
    if not ok:
        return Finding("BLAS", "missing", found, SETUP)
    if "/blas/libblas" in found:
        return Finding("BLAS", "slow", f"{found}, the reference", "install libopenblas0-serial")
    return Finding("BLAS", "ok", found)


def _ranks() -> Finding:
    """Return the row of MPI: whether mpirun starts two ranks of one job."""
    # Only rank 0 prints: the lines of two ranks may be interleaved.
    code = (
        "from mpi4py import MPI; world = MPI.COMM_WORLD\n"
        "if world.rank == 0: print(f'{world.size} ranks start')"
    )
    ok, found = _run(["mpirun", "-n", "2", sys.executable, "-c", code], reason=0)
    if ok and found.startswith("2 "):
        return Finding("MPI ranks", "ok", found)
    if ok:
        return Finding("MPI ranks", "missing", f"mpirun -n 2: {found}", "mpirun is another MPI's")
    remedy = "see what `mpirun -n 2 hostname` says"
    if "PATH" in found:
        remedy = "install openmpi-bin"
    elif "slots" in found:
        remedy = "start it with `mpirun --oversubscribe`"
    elif os.geteuid() == 0 and "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM" not in os.environ:
        found = "Open MPI refuses to run as root"
        remedy = "set OMPI_ALLOW_RUN_AS_ROOT=1 and OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1"
    return Finding("MPI ranks", "missing", found, remedy)


_COMPILES = """
import os, tempfile
from fem_snh.kernels import build
with tempfile.TemporaryDirectory() as folder:
    os.environ["FEM_SNH_CACHE"] = folder
    build.library("int answer(void) { return 42; }")
print(build.compiler())
"""
_WRITES = """
import tempfile
from fem_snh import cache
cache.folder().mkdir(parents=True, exist_ok=True)
tempfile.TemporaryFile(dir=cache.folder()).close()
print(cache.folder())
"""


def _rows() -> list[Callable[[], Finding]]:
    mpi = "m = MPI.Get_library_version().split(',')[0].split(chr(10))[0]; print(v, 'on', m)"
    packages = (
        "from importlib import import_module; from importlib.metadata import version; "
        f"names = {PACKAGES}; [import_module(n) for n in names]; "
        "print(', '.join(f'{n} {version(n)}' for n in names))"
    )
    return [
        _python,
        _probe("dolfinx", "import dolfinx; print(dolfinx.__version__)", SETUP),
        _probe(
            "PETSc",
            "from petsc4py import PETSc; kind = PETSc.ScalarType().dtype; assert kind.kind == 'f', "
            "f'{kind} numbers'; print(*PETSc.Sys.getVersion(), sep='.', end=f', {kind}')",
            "real numbers are needed: install python3-dolfinx-real, unset PETSC_DIR",
        ),
        _probe("petsc4py", "import petsc4py as p; print(p.__version__)", SETUP),
        _probe(
            "mpi4py", f"import mpi4py; v = mpi4py.__version__; from mpi4py import MPI; {mpi}", SETUP
        ),
        _ranks,
        _blas,
        _probe("gmsh", "import gmsh; print(gmsh.__version__)", SETUP),
        _probe(
            "pyvista",
            "import pyvista, vtk; print(f'{pyvista.__version__}, VTK {vtk.VTK_VERSION}')",
            SETUP,
        ),
        _probe(
            "SLEPc",
            "from slepc4py import SLEPc; print(*SLEPc.Sys.getVersion(), sep='.')",
            "needed for eigenfrequencies alone: install python3-slepc4py-real",
        ),
        _probe("packages", packages, SETUP),
        _probe("compiler", _COMPILES, ""),  # its error says what to do
        _probe("cache folder", _WRITES, "set FEM_SNH_CACHE to a folder that can be written"),
    ]


def examine() -> list[Finding]:
    """Return a Finding for each row of the table."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(max_workers=4) as pool:
        return list(pool.map(lambda find: find(), _rows()))


def main() -> int:
    """Print the table on rank 0; return 0 if nothing is missing, otherwise 2."""
    if os.environ.get("OMPI_COMM_WORLD_RANK", os.environ.get("PMI_RANK", "0")) != "0":
        return 0
    findings = examine()
    cells = [(f.what, f.state, f"{f.found}: {f.remedy}" if f.remedy else f.found) for f in findings]
    try:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text
    except ImportError:
        print(*(f"{what:13} {state:8} {found}" for what, state, found in cells), sep="\n")
    else:
        colour = {"ok": "green", "slow": "yellow", "missing": "red"}
        table = Table("", "state", box=None)
        table.add_column("found, and what to do", overflow="fold")
        for what, state, found in cells:
            table.add_row(what, Text(state, colour[state]), Text(found))
        Console().print(table)
    return 2 if any(f.state == "missing" for f in findings) else 0
