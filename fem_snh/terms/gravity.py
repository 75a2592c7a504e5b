"""The weight of a body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

from pydantic import Field

from fem_snh.errors import bad_value
from fem_snh.tables.amplitudes import TABLE, TableName
from fem_snh.tables.types import VectorValue
from fem_snh.tables.validation import is_expression
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


class Gravity(Feature):
    r"""The weight of the body, or another acceleration; materials need a density.

    .. math:: E = -a(\lambda) \int_\Omega \rho\, g \cdot u \, \mathrm{d}V

    With the mass matrix M of a body in motion the forces are M g: with a lumped one the body falls
    without being deformed.
    """

    key, stateless, planar = "gravity", True, True
    vector: VectorValue = Field(description="Acceleration at amplitude 1 [m/s^2].")
    table: TableName | None = Field(default=None, description=TABLE)

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all accelerations. Collective."""
        from fem_snh.terms.dead_load import DeadLoad  # imports PETSc
        from fem_snh.terms.values import is_uniform

        term = DeadLoad(cls.key, body.V)
        for load in features:
            amplitude = body.amplitudes.force(load.table)
            vector = body.components(f"{cls.key}.vector", load.vector)
            given = is_expression(load.vector)
            if body.kinematics.revolved and not given and any(load.vector[::2]):
                accepted = f"a vector along the axis y, in {body.kinematics.name}"
                raise bad_value(f"{cls.key}.vector", list(load.vector), accepted)
            if body.motion and is_uniform(vector):
                term.add_weight(body.motion.mass, vector, amplitude)
            else:
                density = body.density(cls.key) * body.expression(cls.key, vector)
                term.add(density, body.cells, amplitude, given)
        return [term]
