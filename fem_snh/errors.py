"""Exceptions that a user sees, the form of their messages, and their propagation to every rank.

A message has one line: ``<key> = <value>: expected <what is accepted> (did you mean 'x'?)``.
`bad_value`, `unknown_name`, `check_whole`, `check_number` and `choose` write it. The command line
prints the message and returns the exit code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from math import inf, isfinite
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

#: Characters of a value that a message shows; a longer one is cut. A line of a terminal has 80.
_SHOWN = 60
#: Similarity (difflib's ratio) from which a known name is suggested for a misspelt one.
_SIMILAR = 0.5
#: The same for files. It is higher, as a folder also holds files for other purposes.
_SIMILAR_FILE = 0.75


class BadInput(ValueError):
    """A mistake in the input or the environment: exit code 2.

    The message names the key, its value and the accepted values, on one line: line breaks become
    spaces.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(" ".join(str(message).split()))


class ResultNote(UserWarning):
    """A note on a result that has converged: see `fem_snh.records.run_record`."""


class Failed(RuntimeError):
    """A run ended although its input is valid: exit code 1.

    Examples are exhausted memory and an error of PETSc. The steps computed so far are kept.
    """


class OutOfTime(RuntimeError):
    """A level of a run to an accuracy took much longer than was expected."""


class NotSettled(RuntimeError):
    """A step failed although no solve did, for example by alternating lagged quantities."""


def suggestion_for(word: str, known: Iterable[str]) -> str:
    """Return the end of a message, ``" (did you mean 'x'?)"`` with a leading space, or ``""``.

    x is the known word that begins with ``word`` if there is exactly one, otherwise the most
    similar known word, if its difflib ratio is at least 0.5.
    """
    words = [str(k) for k in known]
    longer = [k for k in words if word and k.startswith(str(word))]
    match = longer if len(longer) == 1 else get_close_matches(str(word), words, 1, _SIMILAR)
    return f" (did you mean '{match[0]}'?)" if match else ""


def nearest_file(path: Path) -> str:
    """Return the phrase of `nearest` for a missing file, from files of its folder and suffix."""
    if "\0" in str(path):  # no file has it in its name
        return ""
    stems = [file.stem for file in path.parent.glob(f"*{path.suffix}")]
    match = get_close_matches(path.stem, stems, n=1, cutoff=_SIMILAR_FILE)
    return f" (did you mean '{match[0]}{path.suffix}'?)" if match else ""


def in_words(names: Iterable[object]) -> str:
    """Return one name or more as a list in a sentence: "a", "a and b", "a, b and c"."""
    *first, last = map(str, names)
    return f"{', '.join(first)} and {last}" if first else last


def shown(value: object) -> str:
    """Return the ``repr`` of a value on one line of 60 characters at most, cut if longer.

    Numpy scalars are shown as Python numbers.
    """
    if getattr(value, "shape", None) == () and hasattr(value, "item"):
        value = value.item()  # numpy 2 has np.True_ and np.float64(1.0)
    try:
        # The repr of a UFL expression has the whole mesh.
        text = " ".join((str if hasattr(value, "ufl_shape") else repr)(value).split())
    except ValueError:  # Python prints no whole number of more than 4300 digits
        text = "<a number of too many digits>"
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def bad_value(key: str, value: object, accepted: str, known: Iterable[str] = ()) -> BadInput:
    """Return the exception ``<key> = <value>: expected <accepted>``.

    Parameters
    ----------
    key : str
        The key or option that has the value.
    value : object
        The value, shown by its ``repr`` and cut if it is long.
    accepted : str
        The accepted values, e.g. "a number > 0".
    known : iterable of str
        Accepted words; the nearest to ``value`` is suggested.
    """
    word = value if isinstance(value, str) else ""
    return BadInput(f"{key} = {shown(value)}: expected {accepted}{suggestion_for(word, known)}")


def unknown_name(kind: str, name: str, known: Iterable[str], suggestion: str = "") -> BadInput:
    """Return the exception ``unknown <kind> '<name>': expected one of ...``.

    ``kind`` is what the name is: a key, a parameter, an option. ``suggestion`` ends the message, by
    default the phrase of `nearest`.
    """
    known = list(known)
    listed = f"one of {', '.join(known)}" if known else "none"
    suggestion = suggestion or suggestion_for(name, known)
    return BadInput(f"unknown {kind} {shown(name)}: expected {listed}{suggestion}")


def is_number(text: str) -> bool:
    """Return whether ``float`` accepts a text; "nan" and "inf" are numbers."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def check_whole(key: str, value: object, lowest: int, highest: int) -> None:
    """Raise `bad_value`'s BadInput unless ``value`` is an int in [lowest, highest], no bool."""
    if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
        raise bad_value(key, value, f"a whole number from {lowest} to {highest}")


def check_number(
    key: str, value: object, lowest: float, *, highest: float = inf, exclusive: bool = False
) -> None:
    """Raise `bad_value`'s BadInput unless ``value`` is a finite number in [lowest, highest].

    Parameters
    ----------
    key, value : str, object
        As for `bad_value`. Numbers of Python and numpy are accepted, but no bool.
    lowest, highest : float
        The smallest and the largest number.
    exclusive : bool
        Whether ``lowest`` itself is refused.
    """
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # a whole number beyond the floating-point numbers
            number = inf
        above_lowest = lowest < number if exclusive else lowest <= number
        if isfinite(number) and above_lowest and number <= highest:
            return
    above = f" > {lowest:g}" if exclusive else f" >= {lowest:g}"
    within = f" from {lowest:g} to {highest:g}" if isfinite(highest) else above
    raise bad_value(key, value, f"a number{within}" if isfinite(lowest) else "a finite number")


@dataclass(frozen=True)
class Range:
    """The accepted values of a number; ``str(range)`` describes them.

    Attributes
    ----------
    low, high : float
        The ends.
    whole : bool
        Whether the number is a whole one.
    open_low, open_high : bool
        Whether an end is excluded.
    nonzero : bool
        Whether 0 is excluded.
    words : str
        The description, if it is not the default.
    """

    low: float
    high: float = inf
    whole: bool = False
    open_low: bool = False
    open_high: bool = False
    nonzero: bool = False
    words: str = ""

    def __contains__(self, value: float) -> bool:
        """Return whether a value is accepted; NaN never is."""
        excluded = (self.open_low and value == self.low) or (self.open_high and value == self.high)
        whole = not self.whole or value == inf or value == value // 1
        zero = self.nonzero and value == 0
        return self.low <= value <= self.high and whole and not (excluded or zero)

    def __str__(self) -> str:
        kind = "whole number" if self.whole else "number"
        above = f"{'>' if self.open_low else '>='} {self.low:g}"
        below = f" and {'<' if self.open_high else '<='} {self.high:g}" if self.high < inf else ""
        return self.words or f"a {kind} {above}{below}"


def choose(key: str, word: str, known: Iterable[str]) -> str:
    """Return ``word`` if it is one of the known words; otherwise raise `bad_value`'s BadInput."""
    known = list(known)
    if word not in known:
        raise bad_value(key, word, f"one of {', '.join(known)}", known)
    return word


def on_root(comm: Any, function: Callable[..., T], *args: Any) -> T:
    """Call a function on rank 0 and return its result on every rank. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    function : callable
        The function; its result must be picklable.
    *args : Any
        The function's arguments.

    Raises
    ------
    BadInput
        On every rank, with the message of the BadInput or OSError that rank 0 raised: no rank
        waits in a collective call for one that has failed.
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


def on_every(comm: Any, function: Callable[..., T], *args: Any) -> T:
    """Return the result of a call on each rank; if one rank fails, all raise. Collective.

    Raises
    ------
    BadInput
        On every rank, with the message of the lowest rank that raised a BadInput or an OSError.
    """
    result: T
    message = None
    try:
        result = function(*args)
    except (BadInput, OSError) as error:
        message = str(error)
    failed = [text for text in comm.allgather(message) if text is not None]
    if failed:
        raise BadInput(failed[0])
    return result
