"""Pressures on surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

from pydantic import Field

from fem_snh.errors import bad_value
from fem_snh.tables.amplitudes import TABLE, TableName
from fem_snh.tables.types import SURFACE, ScalarValue, Surface
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


class Pressure(Feature):
    r"""A follower load on a surface: a force per present area, normal to the deformed surface.

    .. math:: R(u; v) = a(\lambda)\, p \int_{\Gamma} \mathrm{cof}(F) N \cdot v \, \mathrm{d}A
    """

    key, stateless, planar = "pressure", True, True
    group: Surface = Field(description=SURFACE)
    value: ScalarValue = Field(
        description="Pressure at amplitude 1 [Pa]; a positive one pushes into the body."
    )
    table: TableName | None = Field(default=None, description=TABLE)

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all pressures: a closed surface may have several. Collective."""
        from fem_snh.terms.follower_pressure import FollowerPressure  # imports PETSc

        if body.kinematics.plane_stress:  # the edge's area has the unknown thickness
            raise bad_value(cls.key, "given", "no value, in plane stress")
        return [FollowerPressure(features, body)]
