"""Stresses and strains at points from the displacement gradient H and the stress P.

The compiled library depends on no material and no element. Runs without such fields do not need it.
"""

from __future__ import annotations

from collections.abc import Collection
from math import prod
from typing import TYPE_CHECKING

import numpy as np

from fem_snh.arrays import Array
from fem_snh.kernels import build

if TYPE_CHECKING:
    from mpi4py import MPI

#: The shape of a value by field. PointFields in point_fields_api.h defines the fields.
POINT_FIELDS: dict[str, tuple[int, ...]] = {
    "cauchy_stress": (3, 3),
    "von_mises": (),
    "principal_stresses": (3,),
    "hydrostatic_stress": (),
    "pk1_stress": (3, 3),
    "green_lagrange_strain": (3, 3),
    "principal_stretches": (3,),
}


class PointFieldLoops:
    """The compiled loop that evaluates `POINT_FIELDS` at points.

    Parameters
    ----------
    comm : communicator of mpi4py
        The ranks, one of which compiles the loop. Collective.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._ffi, self._lib = build.open_library(
            ["point_fields_api.h"],
            ["point_fields.h"],
            [build.svd_eigen_declarations()],
            [build.svd_eigen_object()],
            comm,
        )

    def evaluate(self, H: Array, P: Array, names: Collection[str]) -> dict[str, Array]:
        """Return the values of fields by name, each (cells, points, ...). Not collective.

        Parameters
        ----------
        H : (cells, points, 3, 3)
            Displacement gradients du_i/dX_j; not copied if each component is contiguous in memory,
            as in `fem_snh.runs.output.stress_fields`.
        P : (cells, points, 3, 3)
            First Piola-Kirchhoff stresses [Pa], stored in the same way.
        names : collection of str
            Names of ``POINT_FIELDS``.
        """
        points = H.shape[0] * H.shape[1]
        sizes = {name: points * prod(POINT_FIELDS[name]) for name in names}
        # One allocation: malloc keeps its memory for the next state, which saves page faults.
        memory: Array = np.empty(sum(sizes.values()))
        found = {}
        for name, size in sizes.items():
            part, memory = np.split(memory, [size])
            found[name] = part.reshape(H.shape[:2] + POINT_FIELDS[name])
        by_component = [np.ascontiguousarray(a.transpose(3, 2, 0, 1)) for a in (H, P)]
        pointers = {name: build.cdata(values) for name, values in found.items()}
        out = self._ffi.new("PointFields *", pointers)
        self._lib.point_fields(points, *map(build.cdata, by_component), out)
        return found
