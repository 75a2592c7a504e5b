"""Sphinx extension: the navigation of every page is made from titles alone.

The theme asks for the titles of all pages on each page. For that Sphinx copies the tables of
contents of all pages, with every heading and every object of the reference, and then drops all but
the titles: half of the time to build this site. Here they are dropped first, once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

#: Before the theme's, which has the default, 500.
_PRIORITY = 400


def use_titles(
    app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: nodes.Node
) -> None:
    """Let the page's function ``toctree`` start from titles where it returns only them."""
    if "toctree" in context:
        context["toctree"] = _from_titles(app.builder.env, context["toctree"])


def _from_titles(env: BuildEnvironment, toctree: Callable[..., str]) -> Callable[..., str]:
    def call(**options: Any) -> str:
        if not options.get("titles_only"):
            return toctree(**options)
        whole, env.tocs = env.tocs, _titles(env)
        try:
            return toctree(**options)
        finally:
            env.tocs = whole

    return call


@cache
def _titles(env: BuildEnvironment) -> dict[str, nodes.bullet_list]:
    """Return the tables of contents of all pages with their titles and toctrees alone."""
    return {name: _title(contents) for name, contents in env.tocs.items()}


def _title(contents: nodes.bullet_list) -> nodes.bullet_list:
    """Return what Sphinx leaves of a table of contents where it returns titles only."""
    kept = contents.deepcopy()
    for item in kept.children:
        if isinstance(item, nodes.list_item) and len(item) > 1:
            if toctrees := list(item.findall(addnodes.toctree)):
                item[1][:] = toctrees
            else:
                item.pop(1)
    return kept


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the change to the pages, which are written after all of them have been read."""
    app.connect("html-page-context", use_titles, priority=_PRIORITY)
    return {"parallel_read_safe": True}
