"""The command line's page, from the argparse parsers."""

from __future__ import annotations

import argparse

from fem_snh import cli
from generated.table import table


def markdown() -> str:
    """Return a section for each command: its usage, its description and its options."""
    parts = []
    for name, parser in cli.parsers().items():
        parser.formatter_class = _Wide
        usage = parser.format_usage().removeprefix("usage: ").strip()
        parts += [f"## fem-snh {name}", parser.description or "", f"```text\n{usage}\n```"]
        rows = [_row(action) for action in parser._actions if action.dest != "help"]
        if rows:
            parts.append(table(("argument", "meaning"), rows))
    return "\n\n".join(parts)


class _Wide(argparse.HelpFormatter):
    """Usage lines that are as wide as a page's column."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=88)


def _row(action: argparse.Action) -> tuple[str, str]:
    shown = action.metavar if isinstance(action.metavar, str) else ""
    name = ", ".join(action.option_strings)
    meaning = (action.help or "").replace("%%", "%")
    return f"`{' '.join(part for part in (name, shown) if part)}`", meaning
