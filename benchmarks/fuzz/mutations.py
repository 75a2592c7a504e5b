"""Damage to the bytes of a file."""

from __future__ import annotations

import re
from collections.abc import Callable
from random import Random

#: Words that take the place of a number.
_WORDS = (
    "nan", "inf", "-inf", "1e999", "1e308", "-1e300", "1e160", "1e-300", "0", "-0", "-1", "1", "2",
    "0.5", "255", "65536", "2147483647", "2147483648", "-2147483649", "4294967296", "99999999999",
    "18446744073709551616", "1" * 400, "x", "", "1,5", "0x10", "\u0661", "1e", "--1", "1_0",
)  # fmt: skip
#: A number in text.
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def _flip(random: Random, data: bytes) -> bytes:
    """Replace some bytes."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 8)) if data else 0):
        changed[random.randrange(len(data))] = random.randrange(256)
    return bytes(changed)


def _flip_bit(random: Random, data: bytes) -> bytes:
    """Change one bit."""
    if not data:
        return data
    changed = bytearray(data)
    changed[random.randrange(len(data))] ^= 1 << random.randrange(8)
    return bytes(changed)


def _truncate(random: Random, data: bytes) -> bytes:
    """Leave the end out."""
    return data[: random.randrange(len(data) + 1)]


def _cut(random: Random, data: bytes) -> bytes:
    """Leave some bytes out."""
    start = random.randrange(len(data) + 1)
    return data[:start] + data[start + random.choice((1, 4, 8, 100)) :]


def _insert(random: Random, data: bytes) -> bytes:
    """Put random bytes in."""
    start = random.randrange(len(data) + 1)
    return data[:start] + random.randbytes(random.choice((1, 4, 8, 50))) + data[start:]


def _lines(change: Callable[[Random, list[bytes]], object]) -> Callable[[Random, bytes], bytes]:
    """Return the mutation that changes a list of lines in place."""

    def mutate(random: Random, data: bytes) -> bytes:
        lines = data.split(b"\n")
        change(random, lines)
        return b"\n".join(lines)

    return mutate


def _delete(random: Random, lines: list[bytes]) -> None:
    lines.pop(random.randrange(len(lines)))


def _repeat(random: Random, lines: list[bytes]) -> None:
    lines.insert(random.randrange(len(lines)), random.choice(lines))


def _exchange(random: Random, lines: list[bytes]) -> None:
    i, j = random.randrange(len(lines)), random.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i]


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
TEXT = (
    _replace_number, _replace_number, _replace_number, _lines(_delete), _lines(_repeat),
    _lines(_exchange), _truncate, _flip, _cut, _insert,
)  # fmt: skip
BYTES = (_flip, _flip_bit, _flip_bit, _truncate, _cut, _insert, _replace_number)


def mutate(random: Random, data: bytes, binary: bool = False) -> bytes:
    """Return damaged data: one to three random mutations."""
    for _ in range(random.choice((1, 1, 2, 3))):
        data = random.choice(BYTES if binary else TEXT)(random, data)
    return data
