"""Fixtures of all tests, which run serially and, where marked `mpi`, on several ranks."""

from __future__ import annotations

import functools
import gc
import os
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import pytest
from hypothesis.internal.conjecture import providers
from scene_file import TOML

if TYPE_CHECKING:
    from mpi4py import MPI

if "PYTEST_XDIST_WORKER" in os.environ:
    # Waiting ranks yield their core to the other workers. Each worker has its own folder for Open
    # MPI's files: a job that ends would remove the folder of one that starts.
    os.environ["OMPI_MCA_mpi_yield_when_idle"] = "1"
    os.environ["TMPDIR"] = tempfile.mkdtemp(dir=os.environ["PYTEST_XDIST_FOLDER"])

# A program on one rank starts no daemon of Open MPI 4, which only MPI_Comm_spawn would need.
os.environ["OMPI_MCA_ess_singleton_isolated"] = "1"

# Compilation happens inside some examples, so no deadline.
# The same examples in every run, on every machine.
hypothesis.settings.register_profile(
    "fem_snh", deadline=None, max_examples=50, derandomize=True, database=None
)
hypothesis.settings.load_profile("fem_snh")
# Examples are also constants of local modules, for which Hypothesis parses their sources. Debian's
# packages, sympy and scipy among them, are not in site-packages and counted as local ones.
_is_local = providers.is_local_module_file
providers.is_local_module_file = functools.lru_cache(
    lambda path: "/dist-packages/" not in path and _is_local(path)
)


@pytest.fixture(scope="session")
def comm() -> MPI.Intracomm:
    """Return the communicator of all ranks."""
    from mpi4py import MPI

    return MPI.COMM_WORLD


@pytest.fixture
def folder(comm: MPI.Intracomm, tmp_path: Path) -> Path:
    """Return an empty folder, the same one on every rank."""
    return comm.bcast(tmp_path, root=0)


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    """Return the path of a scene file."""
    path = tmp_path / "block.toml"
    path.write_text(TOML)
    return path


# --- tests that run on one Debian or on one rank only ---------------------------------------------

#: Parameters of tests that select code of dolfinx, FFCx, PETSc, sympy or the compiler: each of
#: their values runs on every Debian, and every combination of them on one. Other parameters are
#: numbers, files with mistakes and messages: their first values run on every Debian.
LIBRARY_PARAMETERS = frozenset(
    (
        "case", "cell", "degree", "element", "field", "filter", "globalization", "hessian",
        "integrator", "kind", "kinematics", "m", "mass", "material", "method", "name", "scene",
        "shape", "solver", "space", "volume",
    )
)  # fmt: skip


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--other-debian",
        action="store_true",
        help="leave out the tests marked one_debian; on one rank, also those that run on several",
    )
    parser.addoption(
        "--every-parameter",
        action="store_true",
        help="on several ranks, run every test with all of its parameters, not the first alone",
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file of which no test would be left: on several ranks, every rank imports them."""
    if not collection_path.name.startswith("test_") or collection_path.suffix != ".py":
        return None
    if config.getoption("other_debian") and _is_left_out(collection_path):
        return True
    ranks = config.option.markexpr == "mpi" and _ranks(config) > 1
    return True if ranks and not _may_have_ranks(collection_path) else None


def _is_left_out(path: Path) -> bool:
    """Return whether a whole file is marked one_debian, without importing it."""
    return bool(re.search(r"^pytestmark = .*\bone_debian\b(?!\()", path.read_text(), re.M))


@functools.lru_cache
def _may_have_ranks(path: Path) -> bool:
    """Return whether a file names the mark, or bodies.pairs, which has it."""
    return bool(re.search(r"\bmpi\b|\bpairs\b", path.read_text()))


@pytest.hookimpl(trylast=True)  # after -m and -k, which may leave out the first parameters
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("mpi") and not _may_have_ranks(item.path):
            raise pytest.UsageError(f"{item.nodeid}: expected the word mpi in its file")
    kept = list(items)
    other_debian, serial = config.getoption("other_debian"), _ranks(config) == 1
    if other_debian:
        place = "serial" if serial else "ranks"
        kept = _each_library_parameter([item for item in kept if not _is_on_one(item, place)])
    first = set({_function(item): item for item in reversed(kept)}.values())
    if serial:
        kept = [item for item in kept if _runs_serially(item)]
        if other_debian:  # Debian 12 runs them on one rank
            kept = [item for item in kept if item not in first or not _has_ranks_everywhere(item)]
    elif not config.getoption("every_parameter"):  # all of them run on one
        kept = [item for item in kept if item in first or not _runs_serially(item)]
    left = set(kept)
    config.hook.pytest_deselected(items=[item for item in items if item not in left])
    items[:] = kept


def _is_on_one(item: pytest.Item, place: str) -> bool:
    """Return whether a test runs on one Debian only: everywhere, or `serial` or on `ranks`."""
    marks = item.iter_markers("one_debian")
    return any(not mark.args or place in mark.args for mark in marks)


def _runs_serially(item: pytest.Item) -> bool:
    """Return whether a test runs on one rank: all do, unless marked mpi(serially=False)."""
    mark = item.get_closest_marker("mpi")
    return mark is None or mark.kwargs.get("serially", True)


def _has_ranks_everywhere(item: pytest.Item) -> bool:
    """Return whether the first parameters of a test run on several ranks on every Debian."""
    return bool(item.get_closest_marker("mpi")) and not _is_on_one(item, "ranks")


def _function(item: pytest.Item) -> str:
    """Return a test without its parameters, e.g. "tests/mesh/test_mesh.py::test_groups"."""
    return item.nodeid.split("[")[0]


def _each_library_parameter(items: list[pytest.Item]) -> list[pytest.Item]:
    """Return each test with its first parameters, and with each value of LIBRARY_PARAMETERS."""
    kept: list[pytest.Item] = []
    values: dict[str, set[tuple[str, str]]] = {}
    for item in items:
        function = _function(item)
        callspec = getattr(item, "callspec", None)
        parameters = callspec.params if callspec else {}
        new = {(k, repr(v)) for k, v in parameters.items() if k in LIBRARY_PARAMETERS}
        if function not in values or not new <= values[function]:
            kept.append(item)
        values.setdefault(function, set()).update(new)
    return kept


def pytest_collection_finish(session: pytest.Session) -> None:
    """Let garbage collections leave out the modules: they took a twentieth of a process's time."""
    gc.freeze()


# --- a test that fails on one rank aborts all ranks -----------------------------------------------
# Otherwise the failed rank would wait in petsc4py's clean-up at exit, a collective, for ranks that
# wait for it in a test.


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("numprocesses", None):
        shared = tempfile.TemporaryDirectory(prefix="fem-snh-", ignore_cleanup_errors=True)
        config.add_cleanup(shared.cleanup)  # after the workers have ended
        os.environ["PYTEST_XDIST_FOLDER"] = shared.name
    if _ranks(config) > 1:
        config.option.maxfail = 1


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    bad = exitstatus not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
    session.config.stash[_FAILED] = bad


def pytest_unconfigure(config: pytest.Config) -> None:
    if _ranks(config) > 1 and config.stash.get(_FAILED, False):
        from mpi4py import MPI

        sys.stdout.flush()
        sys.stderr.flush()
        time.sleep(2 if MPI.COMM_WORLD.rank else 0)  # rank 0 prints first
        MPI.COMM_WORLD.Abort(1)


def _ranks(config: pytest.Config) -> int:
    if config.getoption("numprocesses", None):
        return 1  # each xdist worker starts its own MPI, which must not start in this process
    from mpi4py import MPI

    return int(MPI.COMM_WORLD.size)


_FAILED = pytest.StashKey[bool]()
