"""A progress bar on standard error, for commands that write files one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar for the duration of a ``with`` block.

    Parameters
    ----------
    description : str
        What is being done, beside the bar.

    Yields
    ------
    callable
        Takes the number of items that are done and that of all.
    """
    from rich.console import Console
    from rich.progress import Progress

    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task(description)

    def show(done: int, total: int) -> None:
        bar.start()  # not before: an empty bar leaves a blank line before the message of an error
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        if bar.live.is_started:
            bar.stop()
