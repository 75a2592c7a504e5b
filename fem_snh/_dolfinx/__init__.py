"""One interface to dolfinx 0.5, 0.9 and 0.11; no other part of the package imports dolfinx.

Functions have one signature for all versions. They detect features and compare no version numbers;
a comment at each workaround names the versions that need it.

Local numbering, as in dolfinx: the entities and nodes a rank owns come first, ghosts after them.
Meshes made by `create_mesh` have no ghost cells, so each rank's cells are the ones it owns.
"""

# ruff: noqa: F401, F403
from __future__ import annotations

import dolfinx
from dolfinx.fem import Function, FunctionSpace
from dolfinx.mesh import Mesh

# All public functions of these modules, which no other part of the package imports.
from fem_snh._dolfinx.element_kernels import *
from fem_snh._dolfinx.forms import *
from fem_snh._dolfinx.meshes import *
from fem_snh._dolfinx.programs import *
from fem_snh._dolfinx.spaces import *

version: str = dolfinx.__version__
