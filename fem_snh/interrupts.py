"""Handlers of SIGINT (Ctrl-C) and SIGTERM, which end a run without cutting its output short."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Interrupts:
    """A context in which SIGINT and SIGTERM raise KeyboardInterrupt.

    The previous handlers are restored at its end. In a thread other than the main thread, Python
    allows no handlers, so the context does nothing there.

    Parameters
    ----------
    delay : float
        Seconds between the signal and the exception. Ranks other than 0 use it: while they
        continue, the MPI calls of rank 0 return, and rank 0 can write the status of the run.

    Notes
    -----
    mpirun sends SIGTERM to all ranks when it is interrupted, and SIGKILL a second later;
    that of Open MPI 6 sends SIGKILL alone, after which the status of the run remains ``running``.

    `postponed` does not use a signal mask, as another thread of the process may receive the signal.
    """

    def __init__(self, delay: float = 0.0) -> None:
        self._delay = delay
        self._postponed = self._received = False
        self._previous: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        signals = [signal.SIGINT, signal.SIGTERM, *([signal.SIGALRM] if self._delay else [])]
        if threading.current_thread() is threading.main_thread():
            self._previous = {number: signal.signal(number, self._interrupt) for number in signals}
        return self

    def __exit__(self, *_: Any) -> None:
        if self._delay:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _interrupt(self, number: int, _: Any) -> None:
        """Handle a signal: start the timer of the delay, or raise KeyboardInterrupt, once.

        Further signals are ignored, as the run is ending already, and writes its status: a handler
        in Python, called while the exception is on its way through PETSc, would disturb it.
        """
        if self._delay and number != signal.SIGALRM:
            signal.setitimer(signal.ITIMER_REAL, self._delay)
            return
        self._received = True
        for known in self._previous:
            signal.signal(known, signal.SIG_IGN)
        if not self._postponed:
            raise KeyboardInterrupt

    @contextmanager
    def postponed(self) -> Iterator[None]:
        """Postpone an interruption until the end of this context."""
        self._postponed = True
        try:
            yield
        finally:
            self._postponed = False
        if self._received:
            raise KeyboardInterrupt
