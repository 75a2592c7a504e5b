"""Sphinx configuration of the documentation site; `make docs` builds it, without a network."""

from __future__ import annotations

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "fem_snh"
copyright = "fem_snh authors"
author = "fem_snh authors"
version = release = installed_version("fem_snh")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # equations are typeset without a network
    "sphinxcontrib.bibtex",
]
exclude_patterns = ["_build", "_ext", "inventories"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "substitution"]
myst_heading_anchors = 4
bibtex_bibfiles = ["references.bib"]
bibtex_reference_style = "author_year"

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autosummary_generate = True
napoleon_google_docstring = False
napoleon_use_rtype = False

# The web is read first; the inventories of this folder hold the names that the pages cite, for a
# build without a network (docs/inventories/make.py writes them).
_SITES = {
    "python": "https://docs.python.org/3/",
    "numpy": "https://numpy.org/doc/stable/",
    "dolfinx": "https://docs.fenicsproject.org/dolfinx/main/python/",
    "ufl": "https://docs.fenicsproject.org/ufl/main/",
    "petsc4py": "https://petsc.org/release/petsc4py/",
    "pandas": "https://pandas.pydata.org/docs/",
}
intersphinx_mapping = {
    name: (url, (str(HERE / "inventories" / f"{name}.inv"),))
    for name, url in _SITES.items()
    if (HERE / "inventories" / f"{name}.inv").exists()
}

html_theme = "furo"
html_title = "fem_snh"
html_static_path = ["_static"]
