"""Sphinx extension: a short name in a docstring links to the one object that is called so.

`TrustRegion` is found as ``fem_snh.solver.globalization.TrustRegion`` from every module, as long as
one object alone has that name, and `fem_snh.scenes.Scene` where its class is defined. Commands and
single words in small letters (arguments, keys, materials) stay text where they name no object. In
nitpicky mode all other names that are not found are warnings.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode

#: Attributes and parameters that share a class's name do not count: only these kinds are linked to.
_KINDS = {"class", "exception", "function", "data", "module", "method", "property", "attribute"}


def resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.Node | None:
    """Return a link to the only object whose full name ends in the target, if there is one."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    if not target.replace(".", "").isidentifier():
        return content
    ends = ("." + target, "." + definition(target))
    domain: Any = env.get_domain("py")  # Any: Sphinx declares the base class, without objects
    objects = domain.objects
    found = {
        entry.node_id: entry
        for name, entry in objects.items()
        if f".{name}".endswith(ends) and entry.objtype in _KINDS and not entry.aliased
    }
    if len(found) != 1:
        return content if target.islower() and "." not in target else None
    (entry,) = found.values()
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, content)


def definition(target: str) -> str:
    """Return the full name under which an object that `target` imports is defined."""
    module, _, name = target.rpartition(".")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError):
        return target
    if not hasattr(found, "__qualname__"):
        return name  # a constant
    return f"{found.__module__}.{found.__qualname__}"


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the search to the references that Sphinx itself does not find."""
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True}
