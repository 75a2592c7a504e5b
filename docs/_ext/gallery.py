"""Sphinx extension: the demos as pages of the gallery.

Each ``demos/NAME.py`` is a script in jupytext's percent format: Markdown cells and code cells. It
is converted to ``docs/gallery/NAME.md`` when a build starts, and not executed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jupytext

DEMOS = Path(__file__).parents[2] / "demos"
GALLERY = Path(__file__).parents[1] / "gallery"


def page(script: Path) -> str:
    """Return a demo as Markdown: its text, and its code in fenced blocks."""
    cells = jupytext.read(script, fmt="py:percent").cells
    blocks = [
        c.source if c.cell_type == "markdown" else f"```python\n{c.source}\n```" for c in cells
    ]
    return "\n\n".join(blocks) + "\n"


def write_pages(app: Any = None) -> None:
    """Write the page of every demo; leave those alone that have not changed."""
    for script in sorted(DEMOS.glob("*.py")):
        target, text = GALLERY / f"{script.stem}.md", page(script)
        if not target.exists() or target.read_text() != text:
            target.write_text(text)


def setup(app: Any) -> dict[str, bool]:
    """Connect the conversion to the start of a build."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
