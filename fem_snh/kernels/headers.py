"""The C files that the kernels share, and the sources that depend on no material."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

from fem_snh.choices import EIGENSOLVERS, POINT_FILTERS

#: The vector types, and the SVD and eigensolvers of `svd_eigen_source`.
SVD_AND_EIGENSOLVERS = ("lanes.h", "svd_eigen.h")
#: The functions of a material at a point, and what their callers and they themselves call.
MATERIAL_FUNCTIONS = ("small_strain.h", "parameters.h", "material_functions.h")
#: The loops over points for `fem_snh.kernels.material.Material`.
POINTWISE = ("pointwise_api.h", "pointwise_kernels.h")


def header(name: str) -> str:
    """Return the text of a file of ``fem_snh/kernels/include``."""
    return (files("fem_snh.kernels") / "include" / name).read_text()


def options() -> str:
    """Return the C enums of the eigenvalue filters and the eigensolvers of `fem_snh.choices`.

    The C name is the upper-case name; the value is the position in the tuple.
    """
    enums = (POINT_FILTERS, "eigenvalue filters"), (EIGENSOLVERS, "eigensolvers")
    return "\n".join(
        f"enum {{ {', '.join(name.upper() for name in names)} }}; /* {comment} */"
        for names, comment in enums
    )


def svd_eigen_source() -> str:
    """Return the C source of the 3x3 SVD and eigensolvers, which every kernel is linked with."""
    return _source("svd.h", "eigen3.h")


def svd_eigen_points_source() -> str:
    """Return the C source of their loops over points, which depend on no material."""
    return _source("svd_eigen_api.h", "svd_eigen_kernels.h")


def loops_source(definitions: Sequence[str], names: Sequence[str]) -> str:
    """Return the C source of loops that call the functions of a material at a point.

    Parameters
    ----------
    definitions : sequence of str
        Lines for the top: ``#define`` of the sizes of an element.
    names : sequence of str
        Names of files of ``include/`` with the loops, in this order.
    """
    return "\n".join([*definitions, _source(*MATERIAL_FUNCTIONS, *names)])


def _source(*names: str) -> str:
    files = map(header, (*SVD_AND_EIGENSOLVERS, *names))
    return "\n".join(["#include <math.h>", options(), *files])
