"""Regions of a body: the cells that each material fills."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy.typing as npt

from fem_snh.kernels.pointwise import Material


class Region(NamedTuple):
    """A part of the body that one material fills.

    Attributes
    ----------
    material : Material
        The material.
    cells : (n,) int32
        The region's cells that this rank owns, in ascending order.
    density : float or None
        Mass per reference volume [kg/m^3], for terms that need it.
    """

    material: Material
    cells: npt.NDArray[Any]
    density: float | None = None
