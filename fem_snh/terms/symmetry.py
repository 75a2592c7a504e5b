"""Planes of symmetry of a body: the normal component of the displacement is zero on them."""

from __future__ import annotations

from pydantic import Field

from fem_snh.tables.types import SURFACE, Surface
from fem_snh.tables.validation import Table


class Symmetry(Table):
    """A plane surface, or straight curve in two dimensions, whose nodes slide in its plane.

    The displacement's component along the plane's normal is zero: rollers, on a plane of any
    inclination. Several planes are several conditions; at their common edges and corners all hold.
    In a program it is one of ``bcs``: ``fem_snh.Symmetry(group=ds(3))``.
    """

    group: Surface = Field(description=SURFACE)
