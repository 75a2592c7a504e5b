"""The time that a problem spends in evaluations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, TypeVar

from fem_snh.compile_clock import Stopwatch

T = TypeVar("T")


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
