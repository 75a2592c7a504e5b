"""A symmetric matrix of 3x3 blocks in single precision, and the sweeps of SSOR over it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput
from fem_snh.kernels import build

Array = npt.NDArray[Any]

DECLARATIONS = """
typedef struct {
  int rows;
  const int *start; const int *column; const long *place; const int *aij; const int *middle;
  float *upper; float *diagonal; float *inverse;
  const int *far_start; const int *far_column; float *far;
} Blocks;
long fill(const Blocks *b, const double *values, const double *far, double scale);
double largest(const Blocks *b, const double *values);
void solve_lower(const Blocks *b, float *w);
void sweep_up(const Blocks *b, float beta, const float *z, float *p, float *t, float *w);
double sweep_down(const Blocks *b, const float *p, const float *t, const float *ghosts, float *w,
                  float *q);
double update(const Blocks *b, float alpha, const float *t, const float *q, float *x, float *r,
              float *z);
typedef struct {
  int rows;
  const int *part; const float *modes; const int *column; const int *start; const int *near;
  float *image;
} Coarse;
void coarse_fill(const Blocks *b, const Coarse *c, const double *values, const double *far,
                 double scale, int first, double *E, long width);
void coarse_gather(const Coarse *c, const float *t, double *y);
void coarse_subtract(const Coarse *c, const float *y, float *r);
void coarse_restrict(const Coarse *c, const float *r, double *y);
void coarse_prolong(const Coarse *c, const float *y, float *x);
void coupled(const Blocks *b, const double *values, const double *far, unsigned char *yes);
"""
#: Blocks in a row, at most (block_matrix.h).
_WIDEST = 4096


def source() -> str:
    """The C source, the same for every matrix."""
    names = ("block_matrix.h", "coarse_space.h")
    return "\n".join(Path(__file__).with_name(name).read_text() for name in names)


class Blocks:
    """This rank's rows of a matrix, on a pattern that stays.

    Parameters
    ----------
    path : the compiled `source`.
    near : (indptr, indices) of the blocks in this rank's columns, each row sorted, symmetric.
    far : the same of the columns that other ranks own, numbered from 0; None on one rank.

    Vectors are (3 rows,) float32. Raises BadInput for a row without a diagonal block.
    """

    def __init__(self, path: Any, near: tuple[Array, Array], far: tuple[Array, Array] | None):
        self.ffi, self.lib = build.load(path, DECLARATIONS)
        indptr, indices = near
        self.rows = len(indptr) - 1
        row = np.repeat(np.arange(self.rows), np.diff(indptr))
        middle = np.flatnonzero(indices == row)
        widest = np.diff(indptr).max(initial=0)
        if len(middle) != self.rows or widest > _WIDEST:
            raise BadInput(f"a matrix for SSOR needs its diagonal, and rows of <= {_WIDEST} blocks")
        above = indices > row
        start = np.concatenate([[0], np.cumsum(np.bincount(row[above], minlength=self.rows))])
        floats = 3 * ((3 * np.diff(start) + 7) // 8 * 8)  # three rows, padded as in block_matrix.h
        place = np.concatenate([[0], np.cumsum(floats)]).astype(np.int64)
        ints = [a.astype(np.int32) for a in (start, indices[above], indptr, middle - indptr[:-1])]
        single = [np.zeros(n, np.float32) for n in (place[-1], 9 * self.rows, 9 * self.rows)]
        self._inverse = single[2]
        self._kept: list[Array] = [*ints[:2], place, *ints[2:], *single]
        if far is not None:
            pattern = [np.ascontiguousarray(a, np.int32) for a in far]
            self._kept += [*pattern, np.zeros(9 * len(far[1]), np.float32)]
        self.nbytes = sum(array.nbytes for array in self._kept)
        pointers = [self.pointer(array) for array in self._kept]
        pointers += [self.ffi.NULL] * (11 - len(pointers))  # no columns of other ranks
        self.struct = self.ffi.new("Blocks *", [self.rows, *pointers])

    def pointer(self, array: Array) -> Any:
        """A C pointer to the memory of ``array``, which the caller keeps alive."""
        kind = {
            "float32": "float *", "float64": "double *", "int32": "int *", "int64": "long *",
            "uint8": "unsigned char *",
        }[array.dtype.name]  # fmt: skip
        return self.ffi.cast(kind, array.ctypes.data)

    def weight(self, p: Array) -> float:
        """p.D^-1 p."""
        inverse, rows = self._inverse.reshape(-1, 3, 3), p.reshape(-1, 3)
        return float(np.einsum("ni,nij,nj->", rows, inverse, rows, dtype=float))

    def fill(self, values: int, far: int, scale: float) -> int:
        """Take an AIJ matrix's values, at these addresses, times ``scale``.

        Returns the number of rows whose diagonal block is not positive definite.
        """
        return int(self.lib.fill(self.struct, *self.addresses(values, far), scale))

    def largest(self, values: int) -> float:
        """Of an AIJ matrix's diagonal, in size; infinite if anything there is, or is no number."""
        return float(self.lib.largest(self.struct, *self.addresses(values)))

    def addresses(self, *values: int) -> list[Any]:
        """Addresses of double precision numbers as C pointers."""
        return [self.ffi.cast("double *", address) for address in values]
