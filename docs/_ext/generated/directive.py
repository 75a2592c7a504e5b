"""The directive itself."""

from __future__ import annotations

from collections.abc import Callable

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

from generated import commands, grid, modules, parts

WRITERS: dict[str, Callable[..., str]] = {
    "commands": commands.markdown,
    "grid": grid.markdown,
    "modules": modules.markdown,
    "parts": parts.markdown,
}


class Generated(SphinxDirective):
    """Put the Markdown of one of `WRITERS` in this place of a page."""

    required_arguments = 1
    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        name, *rest = self.arguments
        text = StringList(WRITERS[name](*rest).splitlines(), source=f"generated {name}")
        parent = nodes.Element()
        self.state.nested_parse(text, self.content_offset, parent, match_titles=True)
        return parent.children
