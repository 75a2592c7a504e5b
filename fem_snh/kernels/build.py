"""Compile C source into shared libraries and keep them in a cache.

Ranks, jobs and machines may share the cache: the key is a hash of the source, the compiler, its
flags and the processor, and files are moved into place atomically. The source is kept beside its
library.

The C files that kernels share are in ``include``. This module joins them to the sources that do not
depend on a material.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_snh import cache
from fem_snh.arrays import Array, ArrayLike
from fem_snh.choices import EIGENSOLVERS, POINT_FILTERS
from fem_snh.errors import BadInput, on_root

if TYPE_CHECKING:
    from _cffi_backend import FFI, CData, Lib

#: No -ffast-math: NaN and infinity must keep their IEEE meaning. The code reads neither errno nor
#: floating-point traps; without them GCC vectorises more. The kernels are vectorised by hand: they
#: need the complete unrolling of short loops (-fpeel-loops), square roots of whole vectors
#: (-ftree-slp-vectorize) and vzeroupper before calls of the C library, which GCC inserts with
#: -fexpensive-optimizations only. With -O2 and -fpeel-loops GCC 12 compiles for 1.7 times as long,
#: and the code takes 5 to 30 % longer (GCC 14: 1.5 times, up to 15 %).
FLAGS = (
    "-O1 -fpeel-loops -ftree-slp-vectorize -fexpensive-optimizations -march=native -std=gnu11 "
    "-fno-math-errno -fno-trapping-math -ffp-contract=fast -Wno-psabi -shared -fPIC"
).split()


def compiler() -> str:
    """Return the command of the C compiler: ``$CC`` (options allowed) or gcc, clang or cc.

    Raises
    ------
    BadInput
        If none of these commands is found.
    """
    own = os.environ.get("CC", "").strip()
    candidates = [own] if own else ["gcc", "clang", "cc"]
    for command in candidates:
        name, *options = shlex.split(command)
        if found := shutil.which(name):
            return shlex.join([found, *options])
    raise BadInput(
        f"CC = {own or 'unset'}: expected a C compiler, found no {', '.join(candidates)} "
        "(install gcc, or set CC)"
    )


@lru_cache
def _environment(command: str) -> str:
    """Return a text with the compiler's version and the processor: machine code depends on both.

    Raises BadInput if the compiler cannot be run.
    """
    try:
        version = subprocess.run(
            [*shlex.split(command), "--version"], capture_output=True, text=True, check=True
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        raise BadInput(f"CC = {command}: expected a C compiler such as gcc or clang") from None
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        keys = ("model name", "flags", "Features", "CPU part")
        cpu = sorted({x for x in lines if x.startswith(keys)})
    except OSError:
        cpu = [platform.processor()]
    return "\n".join([command, version, platform.machine(), *cpu])


def fingerprint() -> str:
    """Return a text that identifies the compiler, its flags and the processor."""
    return "\n".join([*FLAGS, _environment(compiler())])


def library(source: str, objects: Sequence[Path] = ()) -> Path:
    """Compile C source unless the cache has its library already.

    Parameters
    ----------
    source : str
        The C source.
    objects : sequence of Path
        Files from `object_file` to link with: they define functions that the source declares.

    Returns
    -------
    Path
        The shared library; the file of the same name with suffix ``.c`` is its source.

    Raises
    ------
    BadInput
        If the cache cannot be written or the compiler fails.
    """
    return _compiled(source, ".so", objects)


def object_file(source: str) -> Path:
    """Compile C source to an object file for several libraries, unless the cache has it.

    Returns the object file's path and raises as `library` does.
    """
    return _compiled(source, ".o")


def linked(objects: Sequence[Path]) -> Path:
    """Link files from `object_file` to a library; return and raise as `library` does."""
    return _compiled("", ".so", objects)


def _compiled(source: str, suffix: str, objects: Sequence[Path] = ()) -> Path:
    """Return the path of the library (.so) or object file (.o), compiled unless cached."""
    command = compiler()
    content = "\n".join([source, *(path.name for path in objects), fingerprint()])
    key = hashlib.sha256(content.encode()).hexdigest()
    name = f"{key[: cache.KEY_DIGITS]}{suffix}"
    target = cache.folder() / name
    if stored(name):
        return target
    try:
        with cache.build_folder() as folder:
            code, compiled = folder / "kernel.c", folder / name
            files = [str(code)] if source else []
            if source:
                code.write_text(source)
            kind = ["-c"] if suffix == ".o" else [*map(str, objects), "-lm"]
            done = subprocess.run(
                [*shlex.split(command), *FLAGS, *files, *kind, "-o", str(compiled)],
                capture_output=True,
                text=True,
            )
            if done.returncode or not compiled.exists():
                log = target.with_suffix(".log")
                log.write_text(done.stderr)
                raise BadInput(f"CC = {command}: could not compile a kernel, see {log}")
            cache.sign(compiled)
            # Move the source first: a compiled file in the cache always has its source beside it.
            if source:
                os.replace(code, target.with_suffix(".c"))
            os.replace(compiled, target)
    except OSError as error:
        raise BadInput(
            f"FEM_SNH_CACHE = {target.parent}: expected a writable folder ({error.strerror})"
        ) from None
    return target


def stored(name: str) -> Path | None:
    """Return the path of the compiled file ``name`` in the cache; None if missing or incomplete.

    Opening a truncated library would end the process (SIGBUS).

    Raises
    ------
    BadInput
        If other users can write into the cache.
    """
    path = cache.folder() / name
    if not os.path.exists(path):  # also where the folder cannot be searched
        return None
    cache.own_folder()
    return path if cache.read_signed(path) is not None else None


#: C pointer types by numpy's one-character codes of array types.
_POINTERS = {
    "d": "double *", "f": "float *", "i": "int *", "l": "long *", "B": "unsigned char *",
}  # fmt: skip


def pointer(ffi: FFI, array: Array) -> CData:
    """Return a C pointer to the memory of a contiguous array, without a copy.

    The pointer object keeps the array alive. Code that stores its address in a C struct must keep
    the array alive.
    """
    return ffi.from_buffer(_POINTERS[array.dtype.char], array)


def cdata(array: ArrayLike, dtype: Any = np.float64) -> CData:
    """Return a C pointer to an array's float64 or int32 values, which it keeps alive.

    The values are a copy unless the array is contiguous and of this ``dtype``.
    """
    kind = "double[]" if dtype is np.float64 else "int[]"
    return plain_types().from_buffer(kind, np.ascontiguousarray(array, dtype))


@functools.cache
def plain_types() -> FFI:
    """Return an FFI object without declarations; all FFI objects share the types of numbers."""
    import _cffi_backend

    return _cffi_backend.FFI()


@functools.cache
def load(path: Path, declarations: str) -> tuple[FFI, Lib]:
    """Open a compiled library, once per process; it is never closed.

    Parameters
    ----------
    path : Path
        From `library`.
    declarations : str
        C declarations of the library's structs and functions.

    Returns
    -------
    (ffi, library)
        See `fem_snh.cache.c_declarations`.

    Raises
    ------
    BadInput
        If the system cannot open the library.
    """
    ffi = cache.c_declarations(declarations)
    try:
        return ffi, ffi.dlopen(str(path))
    except OSError as error:
        raise BadInput(
            f"kernel library {path} cannot be opened ({error}): delete it, or set FEM_SNH_CACHE to "
            "a folder on a file system that is not mounted noexec"
        ) from None


#: Headers for the functions of a material at a point, and for the loops that call these functions.
MATERIAL_FUNCTIONS = ("small_strain.h", "parameters.h", "material_functions.h")
#: The loops over points for `fem_snh.kernels.material.Material`.
POINTWISE = ("pointwise_api.h", "pointwise_kernels.h")


def open_library(
    api: Sequence[str],
    functions: Sequence[str],
    definitions: Sequence[str] = (),
    objects: Sequence[Path] = (),
    comm: Any = None,
) -> tuple[FFI, Lib]:
    """Compile files of ``include`` unless the cache has their library, and open it.

    Parameters
    ----------
    api : sequence of str
        Names of the files with declarations.
    functions : sequence of str
        Names of the files with the functions.
    definitions : sequence of str
        Lines that precede these files, e.g. the ``#define`` of a size.
    objects : sequence of Path
        As for `library`.
    comm : communicator of mpi4py, optional
        If given, the call is collective: rank 0 compiles, and every rank opens the library.

    Returns
    -------
    (ffi, library)
        See `load`.
    """
    declarations = "\n".join(map(header, api))
    includes = "#include <math.h>", "#include <string.h>"
    source = "\n".join([*includes, *definitions, declarations, *map(header, functions)])
    path = library(source, objects) if comm is None else on_root(comm, library, source, objects)
    return load(path, declarations)


def header(name: str) -> str:
    """Return the text of a file of ``fem_snh/kernels/include``."""
    return (files("fem_snh.kernels") / "include" / name).read_text()


def options() -> str:
    """Return the C enums of the eigenvalue filters and the eigensolvers of `fem_snh.choices`.

    The C name is the name in upper case; its value is the name's position in the tuple.
    """
    enums = (POINT_FILTERS, "eigenvalue filters"), (EIGENSOLVERS, "eigensolvers")
    return "\n".join(
        f"enum {{ {', '.join(name.upper() for name in names)} }}; /* {comment} */"
        for names, comment in enums
    )


def svd_eigen_object() -> Path:
    """Return the object file of the 3x3 SVD and eigensolvers, which every kernel is linked with."""
    source = ["#include <math.h>", svd_eigen_declarations(), header("svd.h"), header("eigen3.h")]
    return object_file("\n".join(source))


def svd_eigen_declarations() -> str:
    """Return the C source that declares the SVD and eigensolvers, with enums and lanes.h."""
    return "\n".join([options(), header("lanes.h"), header("svd_eigen.h")])


def loops_source(definitions: Sequence[str], names: Sequence[str]) -> str:
    """Return the C source of loops that call the functions of a material at a point.

    Parameters
    ----------
    definitions : sequence of str
        The first lines: ``#define`` of the sizes of an element.
    names : sequence of str
        Names of the files of ``include/`` with the loops, in the order of inclusion.
    """
    files = map(header, (*MATERIAL_FUNCTIONS, *names))
    return "\n".join([*definitions, "#include <math.h>", svd_eigen_declarations(), *files])
