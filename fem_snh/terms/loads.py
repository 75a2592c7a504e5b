"""Tables of loads: `Traction`, `Pressure`, `Gravity`, and the elastic foundation `Spring`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field

from fem_snh.errors import bad_value
from fem_snh.tables.amplitudes import TABLE, TableName
from fem_snh.tables.types import SURFACE, ScalarValue, Surface, VectorValue
from fem_snh.tables.validation import Bounded, ExpectExpression, is_expression
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
        from fem_snh.terms.ufl_term import UFLTerms  # imports PETSc

        term = UFLTerms(cls.key, body.u)
        for load in features:
            ds, key = body.measure("traction.group", load.group), f"{cls.key}.vector"
            force = body.expression(key, body.components(key, load.vector))
            term.add_load(force, ds, body.amplitudes.force(load.table))
        return [term]


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
        """Return one term of all pressures, as groups may form a closed surface. Collective."""
        from fem_snh.terms.follower_pressure import FollowerPressure  # imports PETSc

        if body.kinematics.plane_stress:  # the edge's area has the unknown thickness
            raise bad_value(cls.key, "given", "no value, in plane stress")
        return [FollowerPressure(features, body)]


class Gravity(Feature):
    r"""The weight of the body, or another acceleration; materials need a density.

    .. math:: E = -a(\lambda) \int_\Omega \rho\, g \cdot u \, \mathrm{d}V

    On a body in motion the forces are M g with its mass matrix M: also if M is lumped, the body
    falls without being deformed.
    """

    key, stateless, planar = "gravity", True, True
    vector: VectorValue = Field(description="Acceleration at amplitude 1 [m/s^2].")
    table: TableName | None = Field(default=None, description=TABLE)

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return the terms of all accelerations. Collective.

        Uniform accelerations of a body in motion make one `Weight`, all others one `UFLTerms`.
        """
        from fem_snh.terms.body import is_uniform
        from fem_snh.terms.ufl_term import UFLTerms  # imports PETSc
        from fem_snh.terms.weight import Weight

        fields, uniform = UFLTerms(cls.key, body.u), []
        for load in features:
            amplitude = body.amplitudes.force(load.table)
            vector = body.components(f"{cls.key}.vector", load.vector)
            given = is_expression(load.vector)
            if body.kinematics.revolved and not given and any(load.vector[::2]):
                accepted = f"a vector along the axis y, in {body.kinematics.name}"
                raise bad_value(f"{cls.key}.vector", list(load.vector), accepted)
            if body.motion and is_uniform(vector):
                uniform.append((vector, amplitude))
            else:
                density = body.density(cls.key) * body.expression(cls.key, vector)
                fields.add_load(density, body.cells, amplitude)
        weights = [Weight(body.V, body.motion.mass, uniform)] if body.motion and uniform else []
        return [*([fields] if len(uniform) < len(features) else []), *weights]


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
        import numpy as np
        import ufl

        from fem_snh.terms.ufl_term import UFLTerms  # imports PETSc

        term, components = UFLTerms(cls.key, body.u), body.kinematics.components
        for spring in features:
            key, k = "spring.stiffness", spring.stiffness
            if is_expression(k):
                k = body.expression(key, k)
                term.depends_on_load |= body.dirichlet.depends_on_load
            else:
                each = k if isinstance(k, tuple) else (k,) * components
                k = body.constant(np.array(body.components(key, each), float))
            forces = [(k[i] if k.ufl_shape else k) * body.u[i] for i in range(components)]
            energy = ufl.inner(ufl.as_vector(forces), body.u) / 2
            amplitude = body.amplitudes.force(spring.table) if spring.table else None
            term.add(energy * body.measure("spring.group", spring.group), amplitude)
        return [term]
