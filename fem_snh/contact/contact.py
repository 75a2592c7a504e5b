"""Contact between the surfaces of bodies, and the keys that all tables of contact have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, field_validator

from fem_snh.choices import CONTACT_METHODS
from fem_snh.errors import bad_value
from fem_snh.tables.types import Positive, Surface, surface_name
from fem_snh.tables.validation import Expect, OneOf, Table
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term

Method = Annotated[str, OneOf(CONTACT_METHODS)]


class ContactTable(Table):
    """A table of contact: a penalty or an augmented Lagrangian."""

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
        """Return the tolerance [m] of a body of this size [m]; None for the default."""
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
        """The pair's name in run.json."""
        return "/".join(map(surface_name, self.groups))

    @property
    def named_groups(self) -> Sequence[tuple[str, Any]]:
        """The keys that name physical groups, and the groups."""
        return [("groups", group) for group in self.groups]

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if two tables have the same groups."""
        taken = set[frozenset[str]]()
        for contact in features:
            groups = frozenset(map(surface_name, contact.groups))
            if groups in taken:
                raise bad_value("contact.groups", list(contact.groups), "one table for each pair")
            taken.add(groups)

    @classmethod
    def goals(cls, features: Sequence[Self]) -> Sequence[str]:
        """Return the names of the forces that second surfaces exert on first ones."""
        return [f"{contact.name}.force" for contact in features]

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all pairs. Collective."""
        from fem_snh.contact.body_contact import BodyContact  # imports PETSc
        from fem_snh.contact.surface_pair import BodyPair

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
