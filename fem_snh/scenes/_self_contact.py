"""The table ``[self_contact]`` of a scene: contact of the body, or of its bodies, with itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, Field

from fem_snh.choices import SELF_CONTACT_METHODS
from fem_snh.errors import bad_value, choose
from fem_snh.tables.types import NonNegative, Positive
from fem_snh.tables.validation import Expect, Table

if TYPE_CHECKING:
    from fem_snh.scenes.schema import Scene

Method = Annotated[
    str,
    Expect(f"one of {', '.join(SELF_CONTACT_METHODS)}"),
    AfterValidator(lambda word: choose("method", word, SELF_CONTACT_METHODS)),
]


#: Keys of the barrier alone, and their defaults.
_IPC = {"distance": None, "friction": 0.0}


class SelfContact(Table):
    """Contact of the body's surface with itself, and of the bodies of one mesh with each other."""

    method: Method = Field(
        description="reference: springs that push samples of the surface out of deformed cells, to "
        "the closest point in the reference configuration; bodies may intersect at the start. ipc: "
        "a barrier, with which the surface never intersects itself; it needs the package ipctk "
        "(fem_snh[contact])."
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


def check_self_contact(scene: Scene) -> None:
    """Raise BadInput if a method of self-contact does not fit the other keys."""
    table = scene.self_contact
    if table is None:
        return
    if table.method == "reference":
        for key, default in _IPC.items():
            if (value := getattr(table, key)) != default:
                raise bad_value(
                    f"self_contact.{key}", value, "no value, as the method is reference"
                )
    elif scene.time and scene.time.integrator == "semi_implicit":
        accepted = "another one with self_contact.method = 'ipc', whose barrier needs a line search"
        raise bad_value("time.integrator", scene.time.integrator, accepted)
