"""The one exception a user sees, and the way every rank sees it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from typing import Any, TypeVar

T = TypeVar("T")


class BadInput(ValueError):
    """A mistake in the input or the environment: one line, exit code 2.

    The message names what is wrong, where, and what would be accepted.
    """


def nearest(word: str, known: Iterable[str]) -> str:
    """``" (did you mean 'x'?)"`` for the known word closest to ``word``, or ``""``."""
    match = get_close_matches(str(word), [str(k) for k in known], n=1, cutoff=0.5)
    return f" (did you mean '{match[0]}'?)" if match else ""


def choose(kind: str, word: str, known: Iterable[str]) -> str:
    """``word`` if it is one of ``known``; otherwise BadInput with the list and the nearest."""
    known = list(known)
    if word not in known:
        raise BadInput(
            f"unknown {kind} '{word}'{nearest(word, known)}: choose from {', '.join(known)}"
        )
    return word


def on_root(comm: Any, function: Callable[..., T], *args: Any) -> T:
    """Call ``function(*args)`` on rank 0 of ``comm`` and return its result on every rank.

    A BadInput (or OSError, told as one) on rank 0 is raised on every rank, so no rank waits in a
    collective for one that has already failed. The result must pickle.
    """
    outcome: tuple[T | None, str | None] = (None, None)
    if comm.rank == 0:
        try:
            outcome = (function(*args), None)
        except (BadInput, OSError) as error:
            outcome = (None, str(error))
    result, message = comm.bcast(outcome, root=0)
    if message is not None:
        raise BadInput(message)
    return result


def on_every(comm: Any, function: Callable[..., None], *args: Any) -> None:
    """Call ``function(*args)`` on every rank: what fails on one is a BadInput on all. Collective.

    It is the lowest failing rank's BadInput or OSError.
    """
    message = None
    try:
        function(*args)
    except (BadInput, OSError) as error:
        message = str(error)
    failed = [found for found in comm.allgather(message) if found is not None]
    if failed:
        raise BadInput(failed[0])


class Failed(RuntimeError):
    """What ended a run that nothing was wrong with: one line, exit code 1.

    Memory that ran out, an error of PETSc's. The steps before it are kept.
    """
