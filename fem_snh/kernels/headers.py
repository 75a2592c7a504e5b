"""The C files that the kernels share, and the sources that depend on no material."""

from __future__ import annotations

from importlib.resources import files

from fem_snh.choices import EIGENSOLVERS, POINT_FILTERS

#: The vector types, and the SVD and eigensolvers of `svd_eigen_source`.
SVD_AND_EIGENSOLVERS = ("lanes.h", "svd_eigen.h")
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


def _source(*names: str) -> str:
    files = map(header, (*SVD_AND_EIGENSOLVERS, *names))
    return "\n".join(["#include <math.h>", options(), *files])
