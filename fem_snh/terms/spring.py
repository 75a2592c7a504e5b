"""Elastic foundations of surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field

from fem_snh.tables.amplitudes import TableName
from fem_snh.tables.types import SURFACE, Surface
from fem_snh.tables.validation import Bounded, ExpectExpression
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term

_Stiffness = Annotated[Bounded, Field(ge=0)]
Stiffness = Annotated[
    _Stiffness | tuple[_Stiffness, _Stiffness, _Stiffness],
    ExpectExpression("a number >= 0, or three of them, [x, y, z]", (0, 1)),
]


class Spring(Feature):
    r"""An elastic foundation: a force per reference area, opposite to the displacement.

    .. math:: E = \frac{a(\lambda)}{2} \int_{\Gamma} k u \cdot u \, \mathrm{d}A
    """

    key, stateless, planar = "spring", True, True
    group: Surface = Field(description=SURFACE)
    stiffness: Stiffness = Field(
        description="Force per reference area and displacement [Pa/m], one of all components or "
        "one of each."
    )
    table: TableName | None = Field(
        default=None,
        description="Name of the [[table]] that the stiffness is multiplied by; "
        "default: it is constant.",
    )

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all foundations. Collective."""
        from fem_snh.terms.foundation import Foundation  # imports PETSc

        return [Foundation(features, body)]
