"""Ctrl-C and SIGTERM: they end a run cleanly, and never in the middle of its output."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Interrupts:
    """KeyboardInterrupt on SIGINT, whoever had taken it, and on SIGTERM, which mpirun sends.

    A context. Inside `undivided` the interruption waits for the end of the block. (A signal mask
    would not do: another thread of the process may be the one to receive the signal.)
    """

    _SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self._waits = self._came = False
        self._before: list[Any] = []

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():  # no other may set handlers
            self._before = [signal.signal(each, self._interrupt) for each in self._SIGNALS]
        return self

    def __exit__(self, *_: Any) -> None:
        for each, handler in zip(self._SIGNALS, self._before, strict=False):
            signal.signal(each, handler)

    def _interrupt(self, *_: Any) -> None:
        self._came = True
        if not self._waits:
            raise KeyboardInterrupt

    @contextmanager
    def undivided(self) -> Iterator[None]:
        """Put interruptions off until the end of the block."""
        self._waits = True
        try:
            yield
        finally:
            self._waits = False
        if self._came:
            raise KeyboardInterrupt
