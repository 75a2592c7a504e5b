"""The seconds in which this process compiled: C kernels, and FFCx's forms and elements."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter


class _Clock:
    seconds, is_running = 0.0, False


_CLOCK = _Clock()


@contextmanager
def compiling() -> Iterator[None]:
    """Count the seconds of the context, once where contexts are nested."""
    if _CLOCK.is_running:
        yield
        return
    start, _CLOCK.is_running = perf_counter(), True
    try:
        yield
    finally:
        _CLOCK.seconds += perf_counter() - start
        _CLOCK.is_running = False


def compile_seconds() -> float:
    """Return the seconds so far; what the cache has takes some milliseconds."""
    return _CLOCK.seconds
