"""The C library of the linear solver: its source, declarations and compile-time sizes."""

from __future__ import annotations

from pathlib import Path

_DECLARATIONS = ("block_matrix_api.h", "coarse_space_api.h")
_FUNCTIONS = ("block_matrix_kernels.h", "coarse_space_kernels.h")

#: Columns of Z per subdomain: one constant and three linear functions for each of 3 components.
COLUMNS = 12


def declarations() -> str:
    """Return the C declarations of structs and functions, for cffi."""
    return "\n".join(Path(__file__).with_name(name).read_text() for name in _DECLARATIONS)


def source() -> str:
    """Return the C source, the same for every matrix."""
    functions = (Path(__file__).with_name(name).read_text() for name in _FUNCTIONS)
    return "\n".join(
        [
            "#include <math.h>",
            "#include <string.h>",
            f"#define COLUMNS {COLUMNS}",
            declarations(),
            *functions,
        ]
    )
