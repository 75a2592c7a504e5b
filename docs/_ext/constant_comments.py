"""Sphinx extension: the comment of a constant is its description, also if it has a colon.

Napoleon reads the words before a colon in the first line as the constant's type ("float: length").
The sources have no types there, so the line is broken after the colon.
"""

from __future__ import annotations

from typing import Any

from sphinx.application import Sphinx

#: Before napoleon, whose priority is the default, 500.
_PRIORITY = 400


def break_first_line(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Break the first line of a constant's comment after its first colon."""
    if what in ("data", "attribute") and lines and ":" in lines[0]:
        before, _, after = lines[0].partition(":")
        if after.startswith(" "):
            lines[:1] = [f"{before}:", after.lstrip()]


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the change to the docstrings that autodoc reads."""
    app.connect("autodoc-process-docstring", break_first_line, priority=_PRIORITY)
    return {"parallel_read_safe": True}
