"""The seconds in which this process compiled: C kernels, and FFCx's forms and elements."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, process_time


class _Clock:
    seconds, processor, is_running = 0.0, 0.0, False


_CLOCK = _Clock()


@contextmanager
def compiling() -> Iterator[None]:
    """Count the seconds of the context, once where contexts are nested."""
    if _CLOCK.is_running:
        yield
        return
    start, working, _CLOCK.is_running = perf_counter(), process_time(), True
    try:
        yield
    finally:
        _CLOCK.seconds += perf_counter() - start
        _CLOCK.processor += process_time() - working
        _CLOCK.is_running = False


class Stopwatch:
    """Seconds since it was made, without those in which this process compiled."""

    def __init__(self) -> None:
        self._compiled = _CLOCK.seconds, _CLOCK.processor
        self._start = perf_counter(), process_time()

    @property
    def seconds(self) -> float:
        """Return the elapsed seconds, without compilation."""
        return perf_counter() - self._start[0] - self.jit

    @property
    def processor(self) -> float:
        """Return the processor seconds of this process, without compilation."""
        return process_time() - self._start[1] - (_CLOCK.processor - self._compiled[1])

    @property
    def jit(self) -> float:
        """Return the elapsed seconds of compilation."""
        return _CLOCK.seconds - self._compiled[0]
