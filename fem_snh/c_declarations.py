"""C declarations for cffi, parsed once and kept in the cache.

cffi parses C in Python: that takes longer than opening a library and all of its calls in a small
run. ``fem_snh._petsc`` and `fem_snh.kernels.build` call it.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import cffi

from fem_snh import cache


def parse(declarations: str) -> Any:
    """Return an FFI object that knows C declarations. Not collective.

    Parameters
    ----------
    declarations : str
        C declarations of structs and functions.

    Returns
    -------
    cffi.FFI or _cffi_backend.FFI
        The second is read from the cache; both have ``new``, ``cast``, ``buffer``,
        ``from_buffer``, ``NULL`` and ``dlopen``.
    """
    name = cache.key("declarations", declarations, cffi.__version__)
    target = cache.folder() / f"{name}.py"
    if (source := _stored(target)) is not None:
        return _ffi(source)
    from cffi.recompiler import make_py_source  # "ABI mode, out of line"; slow to import

    ffi = cffi.FFI()
    ffi.cdef(declarations)
    # A folder that cannot be written: the next run parses them again.
    with suppress(OSError), cache.build_folder() as folder:
        written = folder / target.name
        make_py_source(ffi, f"declarations_{name}", str(written))
        cache.sign(written)
        os.replace(written, target)
    return ffi


def _stored(path: Path) -> bytes | None:
    """Return a module that cffi has written, or None. Raises BadInput for another user's cache."""
    if not os.path.exists(path):  # also where the folder cannot be searched
        return None
    cache.own_folder()
    return cache.read_signed(path)


def _ffi(source: bytes) -> Any:
    """Return the FFI object of a module that cffi has written."""
    names: dict[str, Any] = {}
    exec(source, names)
    return names["ffi"]
