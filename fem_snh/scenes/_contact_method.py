"""The keys that tables of contact have in common: how penetration is resisted."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from fem_snh.choices import CONTACT_METHODS
from fem_snh.errors import bad_value, choose
from fem_snh.tables.types import Positive
from fem_snh.tables.validation import Expect, Table

Method = Annotated[
    str,
    Expect(f"one of {', '.join(CONTACT_METHODS)}"),
    AfterValidator(lambda word: choose("method", word, CONTACT_METHODS)),
]


class ContactTable(Table):
    """A table of contact: a penalty or an augmented Lagrangian."""

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

    @model_validator(mode="after")
    def _check_tolerance(self) -> Self:
        if self.tolerance is not None and not self.augmented:
            raise bad_value("tolerance", self.tolerance, "no value, as the method is penalty")
        return self

    @property
    def augmented(self) -> bool:
        """Whether the method is the augmented Lagrangian."""
        return self.method == "augmented_lagrangian"

    def absolute_tolerance(self, volume: float) -> float | None:
        """Return the tolerance [m] of a body of some volume [m^3]; None for the default."""
        return None if self.tolerance is None else self.tolerance * volume ** (1 / 3)
