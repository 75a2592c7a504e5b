"""API sections of a package: the package itself and its public modules."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module

# A name is described where it is defined, not again where a package imports it.
_MEMBERS = """\
```{{eval-rst}}
.. automodule:: {name}
   :members:
   :ignore-module-all:
   :exclude-members: model_config
```
"""


def markdown(package: str) -> str:
    """Return a section with the members of each public module of a package."""
    first, *names = _modules(package)
    sections = (f"## {name}\n\n{_MEMBERS.format(name=name)}" for name in names)
    return "\n".join([_MEMBERS.format(name=first), *sections])


def _modules(package: str) -> Iterator[str]:
    """Yield the package's name and those of its public modules, at any depth."""
    yield package
    path = import_module(package).__path__
    for module in sorted(pkgutil.iter_modules(path, f"{package}."), key=lambda m: m.name):
        if module.name.rpartition(".")[2].startswith("_"):
            continue
        yield from _modules(module.name) if module.ispkg else (module.name,)
