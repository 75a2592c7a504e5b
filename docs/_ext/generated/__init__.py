"""The directive ``{generated} NAME [ARGUMENT]``: a part of a page made from the program itself.

NAME is ``modules`` (the API of a package, the argument), ``commands`` (from the argparse parsers),
``grid`` (of the pictures of the demos named by the argument) or ``parts`` (of the package). The
other modules write parts of the reference pages into the repository: docs/reference/make.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive with Sphinx."""
    from generated.directive import Generated  # the pages are written without Sphinx

    app.add_directive("generated", Generated)
    return {"parallel_read_safe": True}
