"""The C library of the linear solver: its source, declarations and compile-time sizes."""

from __future__ import annotations

from pathlib import Path

_DECLARATIONS = ("block_matrix_api.h", "coarse_space_api.h")
_FUNCTIONS = ("block_matrix_kernels.h", "coarse_space_kernels.h")

#: Functions per component and subdomain of Z, one for each lane of a vector register.
FUNCTIONS = 4


def columns(block: int) -> int:
    """Return the columns of Z per subdomain for nodes of ``block`` components."""
    return FUNCTIONS * block


def declarations() -> str:
    """Return the C declarations of structs and functions, for cffi."""
    return "\n".join(Path(__file__).with_name(name).read_text() for name in _DECLARATIONS)


def source(block: int) -> str:
    """Return the C source, the same for every matrix whose blocks have ``block`` rows, 2 or 3."""
    functions = (Path(__file__).with_name(name).read_text() for name in _FUNCTIONS)
    return "\n".join(
        [
            "#include <math.h>",
            "#include <string.h>",
            f"#define BLOCK {block}",
            f"#define ENTRIES ((long){block**2})",
            f"#define COLUMNS {columns(block)}",
            declarations(),
            *functions,
        ]
    )
