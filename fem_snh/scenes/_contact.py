"""Tables of a scene for contact between the surfaces of its bodies."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from fem_snh.errors import bad_value
from fem_snh.scenes._contact_method import ContactTable
from fem_snh.tables.types import GroupKey
from fem_snh.tables.validation import Expect

Pair = Annotated[
    tuple[GroupKey, GroupKey],
    Expect("two physical groups of surfaces, by name or number"),
]


class Contact(ContactTable):
    """Contact without friction between two surfaces, as of two bodies of one mesh."""

    groups: Pair = Field(
        description="Two physical groups of surfaces, without a common node; their order does not "
        "matter."
    )

    @field_validator("groups")
    @classmethod
    def _check_groups(cls, groups: tuple[str | int, str | int]) -> tuple[str | int, str | int]:
        if str(groups[0]) == str(groups[1]):
            raise bad_value("groups", list(groups), "two different groups")
        return groups

    @property
    def name(self) -> str:
        """The pair's name in run.json."""
        return f"{self.groups[0]}/{self.groups[1]}"


def check_pairs(contacts: list[Contact]) -> None:
    """Raise BadInput if two tables have the same groups."""
    taken = set[frozenset[str]]()
    for contact in contacts:
        groups = frozenset(map(str, contact.groups))
        if groups in taken:
            raise bad_value("contact.groups", list(contact.groups), "one table for each pair")
        taken.add(groups)
