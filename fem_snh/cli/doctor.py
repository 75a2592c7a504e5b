"""Check the installation: quickly before a solve, and in detail for `fem-snh doctor`.

This module imports only the standard library and modules of this package that do so too, so that it
works where other packages are missing. Each row of the table comes from a separate process, because
a broken MPI or VTK ends its process instead of raising an exception.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from fem_snh.errors import BadInput
from fem_snh.processes import RANK_VARIABLES, RUN_AS_ROOT, import_path, is_rank, without_launcher

if TYPE_CHECKING:
    from fem_snh.cli.options import Parser

#: The repository, if the package is run from one.
_REPOSITORY = Path(__file__).resolve().parents[2]
#: Where Debian installs packages for its own Python.
_DEBIAN_PACKAGES = tuple(
    f"/usr/lib/{folder}python3/dist-packages" for folder in ("", "petsc/lib/", "slepc/lib/")
)
#: Packages that a solve imports; pictures and sweeps import theirs when they need them.
NEEDED = "numpy cffi pydantic mpi4py petsc4py basix ufl ffcx dolfinx".split()
#: Packages that only some solves import: gmsh for a built-in geometry, sympy if a kernel is
#: generated, scipy for contact.
FOUND = "gmsh scipy sympy".split()
#: Packages that pip installs with this one (pyproject.toml), besides those with their own rows.
PACKAGES = "cffi mpmath numpy pandas platformdirs psutil pydantic rich scipy sympy".split()
#: Packages that pip does not install: their names in Debian and in conda-forge.
_SYSTEM = {
    **dict.fromkeys(
        ("dolfinx", "basix", "ufl", "ffcx", "petsc4py", "mpi4py"),
        ("python3-dolfinx-real", "fenics-dolfinx"),
    ),
    "gmsh": ("python3-gmsh", "python-gmsh"),
    "slepc4py": ("python3-slepc4py-real", "slepc4py"),
}
#: Packages that pip installs on request, by the extra that has them.
_EXTRAS = {"pyvista": "pictures", "matplotlib": "pictures", "ipctk": "contact"}


def remedy(package: str) -> str:
    """Return the advice, mostly a command, that makes a Python package importable here."""
    if (_REPOSITORY / "tools" / "setup").exists():
        return "run `make setup` in the repository, then its .venv/bin/fem-snh"
    if package not in _SYSTEM:
        extra = _EXTRAS.get(package)
        wanted = f"'fem_snh[{extra}]'" if extra else package
        return f"run `{sys.executable} -m pip install {wanted}`"
    folders = (Path(folder) for folder in _DEBIAN_PACKAGES)
    if any((folder / name).exists() for folder in folders for name in (package, f"{package}.py")):
        return (
            "Debian has installed it, but this environment does not see Debian's packages: make "
            "one with `/usr/bin/python3 -m venv --system-site-packages DIR`"
        )
    debian, conda = _SYSTEM[package]
    return (
        f"run `apt-get install {debian}` on Debian 12 or newer, or `conda install -c conda-forge "
        f"{conda}`"
    )


def doctor_parser() -> Parser:
    """Return the parser of ``fem-snh doctor``."""
    from fem_snh.cli.options import Parser

    return Parser("doctor", "Check the installation: versions, MPI, BLAS, compiler, cache folder.")


def doctor(argv: list[str]) -> int:
    """Check the installation; return 0 if it is complete, 2 if something is missing."""
    if argv:  # the parser imports packages that may be what is missing
        doctor_parser().parse(argv)
    return main()


def check() -> None:
    """Raise BadInput if a package that a solve needs is missing or PETSc has complex numbers.

    The check imports only packages that a solve imports anyway, so it costs no time. Each rank has
    the same outcome.
    """
    for name in (*NEEDED, *FOUND):
        reason = "no such package"
        try:
            if name in NEEDED:
                import_module(name)
                continue
            if find_spec(name):
                continue
        except Exception as error:  # also a library that is missing, or numpy's ABI: ValueError
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BadInput(f"{sys.executable} cannot import {name} ({reason}): {remedy(name)}")
    from petsc4py import PETSc

    if PETSc.ScalarType().dtype.kind != "f":
        raise BadInput(
            "this PETSc computes with complex numbers: install python3-dolfinx-real and unset "
            "PETSC_DIR, or set it to a PETSc of real numbers"
        )


#: The row of two ranks that start as one job.
_RANKS = "MPI ranks"


class Finding(NamedTuple):
    """A row of the table: the component, its state, its version or error, and a remedy.

    The states are ok, slow, missing, and absent: missing, but only some runs need the component.
    """

    what: str
    state: str
    found: str
    remedy: str = ""


_VERSION = "import {0}; print({0}.__version__)"
#: For each row that a Python program makes: the package that the program imports, or a remedy; and
#: the program's code, which prints a version.
_PROBES = {
    "dolfinx": ("dolfinx", _VERSION.format("dolfinx")),
    "PETSc": (
        "real numbers are needed: install python3-dolfinx-real, unset PETSC_DIR",
        "from petsc4py import PETSc; kind = PETSc.ScalarType().dtype; assert kind.kind == 'f', "
        "f'{kind} numbers'; print(*PETSc.Sys.getVersion(), sep='.', end=f', {kind}')",
    ),
    "petsc4py": ("petsc4py", _VERSION.format("petsc4py")),
    "mpi4py": (
        "mpi4py",
        "import mpi4py; v = mpi4py.__version__; from mpi4py import MPI; "
        "m = MPI.Get_library_version().split(',')[0].split(chr(10))[0]; print(v, 'on', m)",
    ),
    # Only rank 0 prints: the lines of two ranks may be interleaved.
    _RANKS: (
        "see what `mpirun -n 2 hostname` says; with too few slots start `mpirun --oversubscribe`; "
        f"as root set {'=1 and '.join(RUN_AS_ROOT)}=1; mpirun must be that of mpi4py",
        "from mpi4py import MPI; world = MPI.COMM_WORLD\n"
        "assert world.size == 2, f'mpirun -n 2: {world.size} ranks start'\n"
        "if world.rank == 0: print('2 ranks start')",
    ),
    "BLAS": (
        "petsc4py",
        "from petsc4py import PETSc\nimport re\n"
        "maps = {l.split()[-1] for l in open('/proc/self/maps')}\n"
        "names = [m for m in sorted(maps) if re.search(r'blas|mkl_rt|blis|flexiblas|atlas', m)]\n"
        "print(next((n for n in names if 'gsl' not in n), 'unknown'))",
    ),
    "gmsh": ("gmsh", _VERSION.format("gmsh")),
    "pyvista": ("pyvista", "import matplotlib, vtk; " + _VERSION.format("pyvista")),
    "SLEPc": (
        "slepc4py",
        "from slepc4py import SLEPc; print(*SLEPc.Sys.getVersion(), sep='.')",
    ),
    "ipctk": ("ipctk", _VERSION.format("ipctk")),
    "packages": (
        "",  # the remedy is that of the missing package
        "from importlib import import_module; from importlib.metadata import version; "
        f"names = {PACKAGES}; [import_module(n) for n in names]; "
        "print(', '.join(f'{n} {version(n)}' for n in names))",
    ),
    "compiler": (
        "",  # its error says what to do
        "import os, tempfile; from fem_snh.kernels import build\n"
        "with tempfile.TemporaryDirectory() as folder:\n"
        "    os.environ['FEM_SNH_CACHE'] = folder\n"
        "    build.library('int answer(void) { return 42; }')\n"
        "print(build.compiler())",
    ),
    "cache folder": (
        "set FEM_SNH_CACHE to a folder that can be written",
        "import tempfile; from fem_snh import cache\n"
        "cache.folder().mkdir(parents=True, exist_ok=True)\n"
        "tempfile.TemporaryFile(dir=cache.folder()).close(); print(cache.folder())",
    ),
}
#: Rows whose programs start PETSc.
_OF_PETSC = ("dolfinx", "PETSc", "BLAS", "SLEPc")
#: Rows of packages that only some runs need, and what for.
_OPTIONAL = {
    "pyvista": "pictures and pages",
    "SLEPc": "eigenfrequencies",
    "ipctk": "self_contact.method = 'ipc'",
}
#: Seconds after which a probe counts as hung: the first import of VTK from a slow disk takes more
#: than a minute.
_TIMEOUT = 300.0


def find(what: str) -> Finding:
    """Return the row of one of `_PROBES`, from a process of its own."""
    needed, code = _PROBES[what]
    if what in _OF_PETSC:
        code = f"from fem_snh.cli import start_petsc; start_petsc()\n{code}"
    # -P: Python would import from the working directory first, where there may be any file.
    command = [sys.executable, "-P", "-c", code]
    command = ["mpirun", "-n", "2", *command] if what == _RANKS else command
    variables = without_launcher(os.environ, RUN_AS_ROOT) if is_rank() else dict(os.environ)
    try:
        # Open MPI removes its files in TMPDIR when a program ends, also while another one starts.
        with TemporaryDirectory(prefix="fem-snh-", ignore_cleanup_errors=True) as own:
            finished = subprocess.run(
                command, env=variables | import_path() | {"TMPDIR": own}, capture_output=True,
                text=True, timeout=_TIMEOUT, stdin=subprocess.DEVNULL,
            )  # fmt: skip
    except FileNotFoundError:
        return Finding(what, "missing", f"no {command[0]} on the PATH", "install openmpi-bin")
    except subprocess.TimeoutExpired:
        return Finding(what, "missing", f"no answer in {_TIMEOUT:g} s", needed)
    succeeded = finished.returncode == 0
    lines = (finished.stdout if succeeded else finished.stderr or finished.stdout).splitlines()
    words = [line.strip() for line in lines if re.search(r"\w", line)]  # Open MPI ends with a rule
    errors = [line for line in words if re.match(r"[\w.]*(Error|BadInput): ", line)]
    # Python's last line has the error, mpirun's first one.
    line = (errors or words or [f"exit code {finished.returncode}"])[-1 if succeeded else 0]
    detail = line if succeeded else re.sub(r"^[\w.]*(Error|BadInput): ", "", line)
    if "/blas/libblas" in detail:  # direct solvers are ten times slower on it
        return Finding(what, "slow", f"{detail}, the reference", "install libopenblas0-serial")
    if succeeded:
        return Finding(what, "ok", detail)
    named = re.match(r"No module named '(\w+)", detail)
    package = named[1] if named else needed
    action = remedy(package) if package in (*_SYSTEM, *_EXTRAS, *PACKAGES) else needed
    if what in _OPTIONAL and named:
        return Finding(what, "absent", f"{detail}; only {_OPTIONAL[what]} need it", action)
    return Finding(what, "missing", detail, action)


def main() -> int:
    """Print the table on rank 0; return 0 if nothing is missing, otherwise 2."""
    if any(os.environ.get(name, "0") != "0" for name in RANK_VARIABLES):
        return 0
    python = f"{sys.version.split()[0]}, {sys.executable}"
    findings = [Finding("Python", "ok", python)]
    with ThreadPoolExecutor(max_workers=4) as pool:
        findings += pool.map(find, _PROBES)
    for what, state, found, action in findings:
        print(f"{what:13} {state:8} {found}{f': {action}' if action else ''}")
    return 2 if any(f.state == "missing" for f in findings) else 0
