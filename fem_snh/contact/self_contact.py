"""Contact of a body with itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field

from fem_snh.choices import SELF_CONTACT_METHODS
from fem_snh.errors import bad_value
from fem_snh.records.output_fields import CONTACT_PRESSURES, OutputField
from fem_snh.tables.types import NonNegative, Positive
from fem_snh.tables.validation import OneOf
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term

Method = Annotated[str, OneOf(SELF_CONTACT_METHODS)]


class SelfContact(Feature):
    """Contact of the body's surface with itself, and of the bodies of one mesh with each other.

    ``reference`` is the method of Smith et al. 2018, section 6, ``ipc`` that of Li et al. 2020. The
    barrier needs the package ipctk, and no start that intersects.
    """

    key, planar = "self_contact", True
    needs_value = {"distance": ("method", "ipc"), "friction": ("method", "ipc")}
    nodal_fields: ClassVar[Mapping[str, OutputField]] = CONTACT_PRESSURES
    method: Method = Field(
        default=SELF_CONTACT_METHODS[0],
        description="reference: springs that push samples of the surface out of deformed cells, to "
        "the closest point in the reference configuration; bodies may intersect at the start. ipc: "
        "a barrier, with which the surface never intersects itself; it needs the package ipctk "
        "(fem_snh[contact]).",
    )
    stiffness: Positive | None = Field(
        default=None,
        description="reference: contact pressure over penetration [Pa/m]; default: 50 E over the "
        "size of the cells. ipc: stiffness of the barrier [Pa]; default: a tenth of the materials' "
        "modulus.",
    )
    distance: Positive | None = Field(
        default=None,
        description="ipc: distance at which contact begins [m]; default: a tenth of the mean edge "
        "of the surface, at most 0.9 of the smallest distance in the mesh.",
    )
    friction: NonNegative = Field(default=0.0, description="ipc: coefficient of friction.")

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if the integrator has no line search, which the barrier needs."""
        for chosen in features:
            if chosen.method == "ipc" and scene.time and scene.time.integrator == "semi_implicit":
                accepted = "another one with self_contact.method = 'ipc', whose barrier needs a "
                raise bad_value("time.integrator", "semi_implicit", accepted + "line search")

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return the term, of which only the method is imported. Collective."""
        if len(features) > 1:
            raise bad_value("terms", f"{len(features)} of SelfContact", "at most one")
        if not body.regions:
            raise bad_value("terms", "self-contact", "a material: its modulus scales the contact")
        chosen, kinematics = features[0], body.kinematics
        if kinematics.dim == 2 and kinematics.components == 3:
            accepted = f"no self-contact, with kinematics = '{kinematics.name}'"
            raise bad_value(cls.key, chosen.method, accepted)
        if chosen.method == "reference":
            from fem_snh.contact.reference.reference import ReferenceContact  # imports PETSc

            stiffness = chosen.stiffness
            return [ReferenceContact(body.V, body.mesh.skin, body.regions, stiffness, kinematics)]
        from fem_snh.contact.barrier import IPC  # imports PETSc

        values = chosen.stiffness, chosen.distance, chosen.friction
        return [IPC(body.V, body.mesh.skin, body.regions, *values, kinematics)]
