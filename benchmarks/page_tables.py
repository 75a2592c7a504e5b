"""Rewrite the part of a documentation page between two marker lines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from fem_snh.errors import BadInput
from fem_snh.files import replace_file


def markers(benchmark: str) -> tuple[str, str]:
    """Return the lines before and after the part that a benchmark writes."""
    return f"<!-- made by python -m benchmarks {benchmark} -->", "<!-- until here -->"


def split_page(page: Path, benchmark: str) -> tuple[str, str]:
    """Return the text before and after that part of a page.

    Raises
    ------
    BadInput
        If the page cannot be read or has no such lines.
    """
    begin, end = markers(benchmark)
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"write = {page}: cannot be read: {error.strerror}") from None
    before, found_begin, rest = text.partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found_begin and found_end):
        raise BadInput(f"write = {page}: expected a page with the lines {begin} and {end}")
    return before, after


def write_table(page: Path, benchmark: str, parts: tuple[str, str], table: str) -> None:
    """Write the page with a new table or text between its two ``parts``."""
    begin, end = markers(benchmark)
    replace_file(page, f"{parts[0]}{begin}\n\n{table}\n\n{end}{parts[1]}")


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table whose cells are these texts."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
