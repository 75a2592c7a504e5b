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
    "sphinx_design",  # the grid of the gallery
    "generated",  # of this folder's _ext: tables made from the program
    "gallery",  # the demos as pages
    "short_names",  # links of docstrings to names of other modules
    "constant_comments",
    "navigation",
]
exclude_patterns = ["_build", "_ext", "inventories"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "substitution"]
myst_heading_anchors = 4
bibtex_bibfiles = ["references.bib"]
bibtex_reference_style = "author_year"

smartquotes = False  # options have two dashes
default_role = "py:obj"  # `name` in a docstring links to what is called so
suppress_warnings = ["ref.python"]  # a short name that several classes have links to the first one
autodoc_typehints = "signature"
# h5py cannot be imported after dolfinx, which loads another HDF5 library.
autodoc_mock_imports = ["h5py"]
autodoc_member_order = "bysource"
autosummary_generate = True
napoleon_google_docstring = False
napoleon_use_param = False  # types are text: "array (n, 3)" names no class
napoleon_use_rtype = False
napoleon_use_ivar = True  # attributes that are also properties are described once

# docs/inventories holds the names that the pages cite (make.py there writes them), so that the site
# is built without a network.
_SITES = {
    "dolfinx": "https://docs.fenicsproject.org/dolfinx/v0.9.0/python/",
    "mpi4py": "https://mpi4py.readthedocs.io/en/stable/",
    "numpy": "https://numpy.org/doc/stable/",
    "petsc": "https://petsc.org/release/",
    "petsc4py": "https://petsc.org/release/petsc4py/",
    "pandas": "https://pandas.pydata.org/docs/",
    "python": "https://docs.python.org/3/",
    "sympy": "https://docs.sympy.org/latest/",
    "ufl": "https://docs.fenicsproject.org/ufl/2025.2.0.post0/",
}
intersphinx_mapping = {
    name: (url, str(HERE / "inventories" / f"{name}.inv")) for name, url in _SITES.items()
}

nitpicky = True  # a name in a docstring that is not found is a warning
nitpick_ignore_regex = [
    # Types: text such as "array (n, 3)", and classes of packages that have no inventory here.
    ("py:class", r"(?!fem_snh\.).*"),
    ("py:class", r"fem_snh\.(\w+\.)*[A-Z]"),  # type variables
    ("py:exc", r"petsc4py\..*"),  # no entry in the inventory
    ("py:class", r"fem_snh\.scenes\._\w+\.\w+"),  # documented where the package exports them
    ("py:class", r"fem_snh\.(\w+\.)*_\w+"),  # private: checks of annotated types
    ("py:class", r"fem_snh\._dolfinx\..*"),  # internal
]

html_theme = "furo"
html_title = "fem_snh"
html_static_path = ["_static"]
html_css_files = ["site.css"]
