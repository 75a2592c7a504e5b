"""Fixtures for all tests, which run serially and, where marked `mpi`, on several ranks."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from mpi4py import MPI

import hypothesis
import pytest

# Compilation happens inside some examples, so no deadline.
hypothesis.settings.register_profile("fem_snh", deadline=None, max_examples=50)
hypothesis.settings.load_profile("fem_snh")


@pytest.fixture(scope="session")
def comm() -> MPI.Intracomm:
    """All ranks."""
    return MPI.COMM_WORLD


@pytest.fixture
def folder(comm: MPI.Intracomm, tmp_path: Path) -> Path:
    """An empty folder, the same one on every rank."""
    return comm.bcast(tmp_path, root=0)


# --- a test that fails on one rank must not leave the others in a collective ---------------------
# A Python that just ends would: petsc4py's clean-up at exit is a collective, and comes before
# anything that aborts at MPI's end.


def pytest_configure(config: pytest.Config) -> None:
    if MPI.COMM_WORLD.size > 1:
        config.option.maxfail = 1


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    bad = exitstatus not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
    session.config.stash[_FAILED] = bad


def pytest_unconfigure(config: pytest.Config) -> None:
    if MPI.COMM_WORLD.size > 1 and config.stash.get(_FAILED, False):
        sys.stdout.flush()
        sys.stderr.flush()
        time.sleep(2 if MPI.COMM_WORLD.rank else 0)  # for rank 0 to print what it has
        MPI.COMM_WORLD.Abort(1)


_FAILED = pytest.StashKey[bool]()
