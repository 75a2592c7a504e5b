"""Tables of a scene that exert forces: dead loads, pressures, springs and enclosed fluids."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

from pydantic import Field

from fem_snh.scenes._tables import MOTION_TABLE, TABLE, Amplitude, TableName, amplitude, constant
from fem_snh.scenes._types import GroupKey, Number, Positive, Vector
from fem_snh.scenes._validation import Bounded, Expect, Table

_SURFACES = "Physical group of surfaces, by name or number."

_Stiffness = Annotated[Bounded, Field(ge=0)]
Stiffness = Annotated[
    _Stiffness | tuple[_Stiffness, _Stiffness, _Stiffness],
    Expect("a number >= 0, or three of them, [x, y, z]"),
]


class Traction(Table):
    """A dead load on a surface: a force per reference area of constant direction."""

    group: GroupKey = Field(description=_SURFACES)
    vector: Vector = Field(description="Force per reference area at amplitude 1 [Pa].")
    table: TableName | None = Field(default=None, description=TABLE)


class Gravity(Table):
    """The weight of the body, or another acceleration; materials need a density."""

    vector: Vector = Field(description="Acceleration at amplitude 1 [m/s^2].")
    table: TableName | None = Field(default=None, description=TABLE)


class Pressure(Table):
    """A follower load on a surface: a force per present area, normal to the deformed surface."""

    group: GroupKey = Field(description=_SURFACES)
    value: Number = Field(
        description="Pressure at amplitude 1 [Pa]; a positive one pushes into the body."
    )
    table: TableName | None = Field(default=None, description=TABLE)


class Spring(Table):
    """An elastic foundation: a force per reference area, opposite to the displacement."""

    group: GroupKey = Field(description=_SURFACES)
    stiffness: Stiffness = Field(
        description="Force per reference area and displacement [Pa/m], one of all components or "
        "one of each."
    )
    table: TableName | None = Field(
        default=None,
        description="Name of the [[table]] that the stiffness is multiplied by; "
        "default: it is constant.",
    )


class Cavity(Table):
    """A fluid that a surface encloses, of prescribed volume; its pressure is a result."""

    group: GroupKey = Field(description=_SURFACES)
    volume: Number = Field(
        description="Volume of fluid that is added at amplitude 1 [m^3]; "
        "in a symmetric part of a body, the part's share."
    )
    stiffness: Positive | None = Field(
        default=None,
        description="Increase of the fluid's pressure with its compression [Pa/m^3]; "
        "default: 100 E over the volume of the body.",
    )
    table: TableName | None = Field(default=None, description=MOTION_TABLE)


Load = Traction | Gravity | Pressure | Spring | Cavity


def load_amplitudes(
    loads: Sequence[Load], tables: Sequence[Amplitude], duration: float | None
) -> list[Callable[[float], float]]:
    """Return the amplitude of each load as a function of the load parameter.

    In a scene in time, whose load 1 is at ``duration`` [s], forces without a table are constant.
    """
    found = []
    for load in loads:
        default = float if duration is None or isinstance(load, Cavity) else constant
        found.append(amplitude(tables, load.table, default, duration))
    return found
