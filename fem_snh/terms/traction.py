"""Dead loads on surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

from pydantic import Field

from fem_snh.tables.amplitudes import TABLE, TableName
from fem_snh.tables.types import SURFACE, Surface, VectorValue
from fem_snh.tables.validation import is_expression
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


class Traction(Feature):
    r"""A dead load on a surface: a force per reference area of constant direction.

    .. math:: E = -a(\lambda) \int_{\Gamma} t \cdot u \, \mathrm{d}A
    """

    key, stateless, planar = "traction", True, True
    group: Surface = Field(description=SURFACE)
    vector: VectorValue = Field(description="Force per reference area at amplitude 1 [Pa].")
    table: TableName | None = Field(default=None, description=TABLE)

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all tractions. Collective."""
        from fem_snh.terms.dead_load import DeadLoad  # imports PETSc

        term = DeadLoad(cls.key, body.V)
        for load in features:
            ds, key = body.measure("traction.group", load.group), f"{cls.key}.vector"
            force = body.expression(key, body.components(key, load.vector))
            term.add(force, ds, body.amplitudes.force(load.table), is_expression(load.vector))
        return [term]
