"""The seconds in which this process compiled or evaluated: C kernels, FFCx's forms, problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from time import perf_counter, process_time
from typing import Any, TypeVar

T = TypeVar("T")


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


def timed(method: Callable[..., T]) -> Callable[..., T]:
    """Add a method's run time, without compilation, to ``seconds["assemble"]`` of its object."""

    @wraps(method)
    def with_time(self: Any, *arguments: Any, **keywords: Any) -> T:
        watch = Stopwatch()
        try:
            return method(self, *arguments, **keywords)
        finally:
            self.seconds["assemble"] += watch.seconds

    return with_time


@contextmanager
def untimed(problem: Any) -> Iterator[None]:
    """Leave evaluations within this block, as of output, out of the problem's time."""
    seconds = problem.seconds["assemble"]
    try:
        yield
    finally:
        problem.seconds["assemble"] = seconds
