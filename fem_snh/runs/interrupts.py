"""Ctrl-C and SIGTERM: they end a run cleanly, and never in the middle of its output."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Interrupts:
    """KeyboardInterrupt on SIGINT, whoever had taken it, and on SIGTERM, which mpirun sends.

    With ``delay`` [s] it comes that much later. For ranks other than the first: as long as they
    go on, the first one's calls to MPI return, and it can say how the run ended. (mpirun, told to
    end, sends SIGTERM to all ranks, and SIGKILL a second later.)

    A context. Inside `postponed` the interruption waits for the end of the block. (A signal mask
    would not do: another thread of the process may be the one to receive the signal.)
    """

    def __init__(self, delay: float = 0.0) -> None:
        self._delay = delay
        self._waits = self._came = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        signals = [signal.SIGINT, signal.SIGTERM, *([signal.SIGALRM] if self._delay else [])]
        if threading.current_thread() is threading.main_thread():  # no other may set handlers
            self._before = {each: signal.signal(each, self._interrupt) for each in signals}
        return self

    def __exit__(self, *_: Any) -> None:
        if self._delay:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for each, handler in self._before.items():
            signal.signal(each, handler)

    def _interrupt(self, number: int, _: Any) -> None:
        if self._delay and number != signal.SIGALRM:
            signal.setitimer(signal.ITIMER_REAL, self._delay)
            return
        self._came = True
        if not self._waits:
            raise KeyboardInterrupt

    @contextmanager
    def postponed(self) -> Iterator[None]:
        """Put interruptions off until the end of the block."""
        self._waits = True
        try:
            yield
        finally:
            self._waits = False
        if self._came:
            raise KeyboardInterrupt
