"""Damage to the bytes of a file."""

from __future__ import annotations

import re
from pathlib import Path
from random import Random

#: Share of the files that are not damaged.
WHOLE = 2 / 3
#: Words that take the place of a number.
_WORDS = (
    "nan", "inf", "-inf", "1e999", "1e308", "-1e300", "1e160", "1e-300", "0", "-0", "-1", "1", "2",
    "0.5", "255", "65536", "2147483647", "2147483648", "-2147483649", "4294967296", "99999999999",
    "18446744073709551616", "1" * 400, "x", "", "1,5", "0x10", "\u0661", "1e", "--1", "1_0",
)  # fmt: skip
#: A number in text.
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def _flip(random: Random, data: bytes) -> bytes:
    """Replace a byte, or change one of its bits."""
    changed = bytearray(data or b"x")
    at = random.randrange(len(changed))
    changed[at] = random.choice((random.randrange(256), changed[at] ^ 1 << random.randrange(8)))
    return bytes(changed)


def _truncate(random: Random, data: bytes) -> bytes:
    """Leave the end out."""
    return data[: random.randrange(len(data) + 1)]


def _cut(random: Random, data: bytes) -> bytes:
    """Leave some bytes out."""
    start = random.randrange(len(data) + 1)
    return data[:start] + data[start + random.choice((1, 4, 8, 100)) :]


def _lines(random: Random, data: bytes) -> bytes:
    """Leave a line out, repeat it, or put another one in its place."""
    lines = data.split(b"\n")
    at = random.randrange(len(lines))
    lines[at : at + 1] = random.choice(([], [lines[at]] * 2, [random.choice(lines)]))
    return b"\n".join(lines)


def _replace_number(random: Random, data: bytes) -> bytes:
    """Replace a number by a word, by another number of the file, or by itself times something."""
    numbers = list(_NUMBER.finditer(data))
    if not numbers:
        return _flip(random, data)
    match = random.choice(numbers)
    kind = random.randrange(3)
    if kind == 0:
        new = random.choice(_WORDS).encode()
    elif kind == 1:
        new = random.choice(numbers).group()
    else:
        scale = random.choice((-1, 0.5, 3, 1e-8, 1e8, 1e160, 1e-160))
        new = repr(float(match.group()) * scale).encode()
    return data[: match.start()] + new + data[match.end() :]


#: Mutations of text and of bytes.
TEXT = (_replace_number, _replace_number, _lines, _truncate, _flip, _cut)
BYTES = (_flip, _flip, _truncate, _cut, _replace_number)


def mutate(random: Random, data: bytes, binary: bool = False) -> bytes:
    """Return data that are damaged in one place."""
    return random.choice(BYTES if binary else TEXT)(random, data)


def write(random: Random, path: Path, data: bytes, binary: bool = False) -> str:
    """Write a file, "whole" in two of three cases, else "damaged" in one place; return which."""
    whole = random.random() < WHOLE
    path.write_bytes(data if whole else mutate(random, data, binary))
    return "whole" if whole else "damaged"
