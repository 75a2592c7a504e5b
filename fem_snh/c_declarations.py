"""C declarations for cffi, parsed once and kept in the cache.

cffi parses C in Python: that takes longer than opening a library and all of its calls in a small
run. ``fem_snh._petsc`` and `fem_snh.kernels.build` call it.
"""

from __future__ import annotations

import os
import runpy
import tempfile
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
        The second is read from the cache; both have ``new``, ``cast``, ``buffer``, ``NULL`` and
        ``dlopen``.
    """
    name = cache.key("declarations", declarations, cffi.__version__)
    target = cache.folder() / f"{name}.py"
    with suppress(OSError, SyntaxError, ValueError, KeyError):
        return runpy.run_path(str(target))["ffi"]
    from cffi.recompiler import make_py_source  # "ABI mode, out of line"; slow to import

    ffi = cffi.FFI()
    ffi.cdef(declarations)
    with suppress(OSError):  # a folder that cannot be written: the next run parses them again
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix="build-") as folder:
            written = Path(folder, target.name)
            make_py_source(ffi, f"declarations_{name}", str(written))
            os.replace(written, target)
    return ffi
