"""Runs in a thread other than the main one."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import Any

import pytest
from running import solve


@pytest.mark.parametrize("first", [True, False])
def test_a_run_in_a_thread(tmp_path: Path, first: bool) -> None:
    """It is the run of the main thread, and leaves the handlers of signals as they are."""
    options: dict[str, Any] = {"cells": 2, "steps": 1, "angle": 0.3}
    handler = signal.getsignal(signal.SIGINT)
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(solve(out=tmp_path / "a", **options)))
    if not first:
        results.append(solve(**options))
    thread.start()
    thread.join()
    if first:
        results.append(solve(**options))
    assert len(results) == 2 and signal.getsignal(signal.SIGINT) is handler
    (one, other) = (result.steps[-1] | {"seconds": 0} for result in results)
    assert one == other and one["converged"]
    assert (tmp_path / "a" / "fields.pvd").exists()
