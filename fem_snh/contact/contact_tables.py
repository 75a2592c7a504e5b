"""The scene's tables ``[[contact]]`` and ``[self_contact]``, and the base of contact tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field, field_validator

from fem_snh.choices import CONTACT_METHODS, SELF_CONTACT_METHODS
from fem_snh.errors import bad_value
from fem_snh.records.output_fields import CONTACT_PRESSURES, OutputField
from fem_snh.tables.types import Positive, Surface, surface_name
from fem_snh.tables.validation import Expect, OneOf, Table
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


Method = Annotated[str, OneOf(CONTACT_METHODS)]


class ContactTable(Table):
    """The keys that ``[[contact]]`` and ``[[obstacle]]`` share: method, stiffness, tolerance."""

    needs_value = {"tolerance": ("method", "augmented_lagrangian")}
    method: Method = Field(
        default=CONTACT_METHODS[0],
        description="A penalty, which leaves a penetration, or an augmented Lagrangian, which "
        "reduces it below a tolerance.",
    )
    stiffness: Positive | None = Field(
        default=None,
        description="Contact pressure over penetration [Pa/m]; default: from the moduli and the "
        "size of the cells at the surface; of two surfaces, of the softer one.",
    )
    tolerance: Positive | None = Field(
        default=None,
        description="Largest penetration with the augmented Lagrangian, relative to V^(1/3), V "
        "the reference volume; default: a thousandth of the size of the cells at the surface.",
    )

    @property
    def augmented(self) -> bool:
        """Whether the method is the augmented Lagrangian."""
        return self.method == "augmented_lagrangian"

    def absolute_tolerance(self, length: float) -> float | None:
        """Return the largest penetration [m] on a body of size ``length`` [m].

        None: the table has no tolerance, and the default applies.
        """
        return None if self.tolerance is None else self.tolerance * length


Pair = Annotated[
    tuple[Surface, Surface],
    Expect("two physical groups of surfaces, by name or number; in a program measures ds(...)"),
]


class Contact(Feature, ContactTable):
    """Contact without friction between two surfaces, as of two bodies of one mesh."""

    key, planar = "contact", True
    groups: Pair = Field(
        description="Two surfaces without a common node, physical groups or in a program measures "
        "ds(...); their order does not matter."
    )

    @field_validator("groups")
    @classmethod
    def _check_groups(cls, groups: tuple[Any, Any]) -> tuple[Any, Any]:
        if surface_name(groups[0]) == surface_name(groups[1]):
            raise bad_value("groups", list(groups), "two different groups")
        return groups

    @property
    def name(self) -> str:
        """The pair's name in run.json: the names of its groups, joined by "/"."""
        return "/".join(map(surface_name, self.groups))

    @property
    def named_groups(self) -> Sequence[tuple[str, Any]]:
        """The two groups, each with the key that names it: ``("groups", group)``."""
        return [("groups", group) for group in self.groups]

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if two tables have the same two groups, in either order."""
        taken = set[frozenset[str]]()
        for contact in features:
            groups = frozenset(map(surface_name, contact.groups))
            if groups in taken:
                raise bad_value("contact.groups", list(contact.groups), "one table for each pair")
            taken.add(groups)

    @classmethod
    def goals(cls, features: Sequence[Self]) -> Sequence[str]:
        """Return each pair's ``NAME.force``: the force on its first surface."""
        return [f"{contact.name}.force" for contact in features]

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one `BodyContact` for all pairs.

        Collective. Raises BadInput for axisymmetric torsion.
        """
        from fem_snh.contact.body_contact import (
            BodyContact,  # imports PETSc
            BodyPair,
        )

        kinematics = body.kinematics
        if kinematics.dim == 2 and kinematics.components == 3:
            accepted = f"no contact, with kinematics = '{kinematics.name}'"
            raise bad_value("contact.groups", features[0].name, accepted)
        pairs = []
        for contact in features:
            first, second = (body.facets("contact.groups", group) for group in contact.groups)
            tolerance = contact.absolute_tolerance(body.length)
            method = contact.stiffness, contact.augmented, tolerance, body.motion is None
            pairs.append(BodyPair(contact.name, first, second, *method))
        return [BodyContact(body.V, body.regions, pairs, kinematics)]


SelfContactMethod = Annotated[str, OneOf(SELF_CONTACT_METHODS)]


class SelfContact(Feature):
    """Contact of the body's surface with itself, and of the bodies of one mesh with each other.

    ``reference`` is the method of Smith et al. 2018, section 6, ``ipc`` the method of Li et al.
    2020, which needs the package ipctk and a surface that does not intersect itself at the start.
    """

    key, planar = "self_contact", True
    needs_value = {"distance": ("method", "ipc")}
    nodal_fields: ClassVar[Mapping[str, OutputField]] = CONTACT_PRESSURES
    method: SelfContactMethod = Field(
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

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput for ``ipc`` with an integrator without a line search."""
        for chosen in features:
            if chosen.method == "ipc" and scene.time and scene.time.integrator == "semi_implicit":
                accepted = "another one with self_contact.method = 'ipc', whose barrier needs a "
                raise bad_value("time.integrator", "semi_implicit", accepted + "line search")

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return a `ReferenceContact` or an `IPC`; import only the chosen method.

        Collective. Raises BadInput for several tables, axisymmetric torsion or no material.
        """
        if len(features) > 1:
            raise bad_value("terms", f"{len(features)} of SelfContact", "at most one")
        if not body.regions:
            raise bad_value("terms", "self-contact", "a material: its modulus scales the contact")
        chosen, kinematics = features[0], body.kinematics
        if kinematics.dim == 2 and kinematics.components == 3:
            accepted = f"no self-contact, with kinematics = '{kinematics.name}'"
            raise bad_value(cls.key, chosen.method, accepted)
        if chosen.method == "reference":
            from fem_snh.contact.reference_contact import ReferenceContact  # imports PETSc

            stiffness = chosen.stiffness
            return [ReferenceContact(body.V, body.mesh.skin, body.regions, stiffness, kinematics)]
        from fem_snh.contact.barrier import IPC  # imports PETSc

        values = chosen.stiffness, chosen.distance, kinematics
        return [IPC(body.V, body.mesh.skin, body.regions, *values)]
