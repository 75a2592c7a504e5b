"""Meshes from gmsh on rank 0: of the built-in sources, of files, and of bodies to fill.

Files of users are read in a child process, as gmsh can crash on a damaged file.
`fem_snh.mesh.mesh.distribute` turns the errors raised here into BadInput on every rank.
"""

from __future__ import annotations

import os
import re
import threading
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from fem_snh import _dolfinx, processes
from fem_snh.cache import key, read_object, sources, write_object
from fem_snh.choices import DEFAULT_CELLS
from fem_snh.errors import BadInput, choose
from fem_snh.mesh import gmsh_model
from fem_snh.mesh.gmsh_model import MeshData, SizeField

#: The first bytes of a .msh file; gmsh executes any other text as a script.
_HEADERS = (b"$MeshFormat", b"$Comments")
#: Most nodes of all cells of a mesh in the cache: 20,000 hexahedra of 27 nodes, a file of 5 MB.
#: gmsh takes longer to import than to generate it.
_LARGEST_STORED = 540_000
#: Most meshes in the cache.
_MOST_STORED = 50


def source_path(source: str) -> Path:
    """Return the file meshes/<source>.geo, in the package or beside it.

    Raises
    ------
    BadInput
        For an unknown source.
    """
    here = Path(__file__).resolve().parents[1]
    folders = [here / "meshes", here.parent / "meshes"]
    known = {p.stem: p for folder in folders for p in sorted(folder.glob("*.geo"))}
    return known[choose("mesh.source", source, sorted(known))]


def generate(
    path: Path, cell: str, parameters: dict[str, float], sizes: SizeField | None = None
) -> MeshData:
    """Mesh a built-in gmsh source; see `gmsh_model.generate`.

    gmsh executes the source, so ``path`` must be a result of `source_path`. The cache has the mesh
    of an earlier call with the same arguments, as it takes 0.2 s to import gmsh; never one with
    ``sizes``.
    """
    name = None if sizes else _name_in_cache(path, cell, parameters)
    if name and (stored := read_object(name)) is not None:
        return _in_dolfinx_order(stored)
    arguments = path, cell, parameters, sizes
    if threading.current_thread() is threading.main_thread():
        data = gmsh_model.generate(*arguments)
    else:  # gmsh installs a signal handler, which Python allows in the main thread only
        data = processes.call("gmsh", gmsh_model.generate, *arguments)
    if name and data.cells.size <= _LARGEST_STORED:
        write_object(name, data, _MOST_STORED)
    return _in_dolfinx_order(data)


def _name_in_cache(path: Path, cell: str, parameters: dict[str, float]) -> str | None:
    """Return the name of a mesh's file in the cache, None without gmsh.

    The name depends on the source, on gmsh (its Python module's path, time and size, as only an
    import tells the version), on numpy, which reads the file, and on this folder's modules.
    """
    gmsh = find_spec("gmsh")
    if not gmsh or not gmsh.origin:
        return None
    file = os.stat(gmsh.origin)
    version = gmsh.origin, file.st_mtime_ns, file.st_size, np.__version__
    text = path.read_text(encoding="utf-8")
    return f"{key('mesh', text, cell, parameters, version, sources('mesh'))}.mesh"


def read(path: str) -> MeshData:
    """Read a .msh file. Raises BadInput and OSError."""
    with open(path, "rb") as file:
        if not file.read(max(map(len, _HEADERS))).startswith(_HEADERS):
            raise BadInput("this is not a gmsh .msh file; an exact geometry is an .xao file")
    # gmsh executes an option file m.msh.opt beside m.msh; a new folder has none.
    with TemporaryDirectory(prefix="fem_snh-") as folder:
        link = Path(folder) / "mesh.msh"
        link.symlink_to(Path(path).resolve())
        return _in_dolfinx_order(processes.call("gmsh", gmsh_model.read, str(link)))


def mesh_shape(path: str, cells: int = DEFAULT_CELLS, sizes: SizeField | None = None) -> MeshData:
    """Mesh the shape of an .xao file; see `gmsh_model.mesh_shape`. Raises BadInput and OSError."""
    open(path, "rb").close()
    with TemporaryDirectory(prefix="fem_snh-") as folder:
        arguments = os.path.abspath(path), folder, cells, sizes
        return _in_dolfinx_order(processes.call("gmsh", gmsh_model.mesh_shape, *arguments))


def fill(points: np.ndarray, triangles: np.ndarray, size: float) -> MeshData:
    """Return a closed surface's tetrahedra; see `gmsh_model.fill`."""
    return _in_dolfinx_order(processes.call("gmsh", gmsh_model.fill, points, triangles, size))


def _in_dolfinx_order(data: MeshData) -> MeshData:
    """Return a mesh with the nodes of each cell in dolfinx's order instead of gmsh's."""
    return data._replace(
        cells=data.cells[:, _dolfinx.gmsh_permutation(data.cell, data.cells.shape[1])]
    )


class SourceParameter(NamedTuple):
    """A parameter of a source.

    Attributes
    ----------
    default, least : float
        The default and the least value.
    step : float
        The number of which all values are multiples.
    """

    default: float
    least: float
    step: float


@cache
def parameter(source: str, name: str) -> SourceParameter | None:
    """Return a parameter in the DefineConstant of meshes/<source>.geo; None if it has none."""
    found = re.search(rf"^  {name} = {{([^,]+),([^}}]*)", _text(source), re.MULTILINE)
    if not found:
        return None
    default, rest = found.groups()
    bounds = dict(re.findall(r"(Min|Step) ([-+.\d]+)", rest))
    return SourceParameter(
        float(default), float(bounds.get("Min", 0)), float(bounds.get("Step", 1))
    )


@cache
def has_free_sizes(source: str, dim: int) -> bool:
    """Return whether a size field may determine the cells: no rows or layers are prescribed."""
    text = _text(source)
    return "Transfinite" not in text and not (dim == 3 and "Layers" in text)


def _text(source: str) -> str:
    return source_path(source).read_text(encoding="utf-8")
