"""The directive ``{generated} NAME [ARGUMENT]``: a part of a page made from the program itself.

NAME is ``modules`` (the API of a package, the argument), ``commands`` (from the argparse parsers),
``scene`` (from the pydantic schema), ``fields`` (of the output), ``grid`` (of the pictures of the
demos named by the argument), ``petsc-options`` (from the solver's table), ``scenes`` or
``materials`` (the built-in ones).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from generated import builtin, commands, fields, grid, modules, parts, petsc, scene

WRITERS: dict[str, Callable[..., str]] = {
    "commands": commands.markdown,
    "fields": fields.markdown,
    "grid": grid.markdown,
    "materials": builtin.materials,
    "modules": modules.markdown,
    "parts": parts.markdown,
    "petsc-options": petsc.markdown,
    "scene": scene.markdown,
    "scenes": builtin.scenes,
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


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive with Sphinx."""
    app.add_directive("generated", Generated)
    return {"parallel_read_safe": True}
