"""The scene's table of a fluid that a surface encloses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from pydantic import Field

from fem_snh.errors import BadInput, bad_value
from fem_snh.tables.amplitudes import MOTION_TABLE, TableName
from fem_snh.tables.types import SURFACE, Positive, ScalarValue, Surface, surface_name
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


class Cavity(Feature):
    """A fluid that a surface encloses, of prescribed volume; its pressure is a result."""

    key, planar, stateless = "cavity", True, True
    group: Surface = Field(description=SURFACE)
    volume: ScalarValue = Field(
        description="Volume of fluid that is added at amplitude 1 [m^3], in a plane per thickness; "
        "in a symmetric part of a body, the part's share."
    )
    stiffness: Positive | None = Field(
        default=None,
        description="Increase of the fluid's pressure with its compression [Pa/m^3]; "
        "default: 100 E over the volume of the body.",
    )
    table: TableName | None = Field(default=None, description=MOTION_TABLE)

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if the scene asks for vibration modes."""
        if scene.modes:
            raise BadInput("'cavity' and 'modes' exclude each other: expected one of them")

    @classmethod
    def goals(cls, features: Sequence[Self]) -> Sequence[str]:
        """Return the names of the fluids' pressures."""
        return [f"{surface_name(fluid.group)}.pressure" for fluid in features]

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term for each fluid; raises BadInput if surfaces share a facet. Collective."""
        from fem_snh.terms.enclosed_fluid import EnclosedFluid  # imports PETSc

        if body.kinematics.plane_stress:  # the edge's area has the unknown thickness
            raise bad_value(cls.key, "given", "no value, in plane stress")
        facets = [body.facets("cavity.group", fluid.group) for fluid in features]
        for (first, a), (second, b) in combinations(zip(features, facets, strict=True), 2):
            if shared := body.domain.comm.allreduce(len(np.intersect1d(a, b))):
                other = f"that of cavity {first.group!r}, not {shared}"
                accepted = f"a surface that shares no facet with {other}"
                raise bad_value("cavity.group", second.group, accepted)
        return [EnclosedFluid(fluid, body) for fluid in features]
