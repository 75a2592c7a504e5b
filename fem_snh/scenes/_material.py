"""The material of a scene: its name, its moduli, and whatever that material takes."""

from __future__ import annotations

import re
from inspect import formatannotation
from typing import Annotated, Any, get_type_hints

from pydantic import (
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)

from fem_snh.errors import BadInput, choose, unknown_name
from fem_snh.scenes._validation import Expect, Finite, Table

_STRICT = ConfigDict(allow_inf_nan=False, strict=True)


class MaterialChoice(Table):
    """A material by name, Young's modulus E [Pa], Poisson's ratio, and what else it takes.

    That is: its shape parameters, the constants [Pa] that may be pinned where it has more than two,
    and what can be done to any material (`fem_snh.materials.TUNING`).
    """

    model_config = ConfigDict(extra="allow")  # checked against the material's own, below

    name: Annotated[str, Expect("the name of a material, see `fem-snh materials`")]
    E: Annotated[Finite, Field(gt=0), Expect("a number > 0 (Young's modulus)")]
    nu: Annotated[
        Finite,
        Field(gt=-1, le=0.5),
        Expect("a number in (-1, 0.5]; 0.5 itself takes a Taylor-Hood element"),
    ]

    @property
    def parameters(self) -> dict[str, Any]:
        """What was given besides, e.g. ``{"barrier": True, "alpha": 2.0}``."""
        return dict(self.model_extra or {})

    @field_validator("name")
    @classmethod
    def _known(cls, name: str) -> str:
        from fem_snh.materials import names

        return choose("material", name, names())

    @model_validator(mode="after")
    def _shape(self) -> MaterialChoice:
        from fem_snh.materials import TUNING, defaults, function, names, pins
        from fem_snh.materials.tuning import check

        kinds: dict[str, Any] = dict.fromkeys(TUNING, float | None)
        kinds["lambda_part"] = str | None
        kinds |= get_type_hints(function(self.name)) | dict.fromkeys(pins(self.name), float | None)
        own = [*defaults(self.name), *pins(self.name)]
        known = ["name", "E", "nu", *own, *TUNING]
        given = self.model_extra or {}
        for key, value in given.items():
            if key not in known:
                raise unknown_name("parameter", key, known)
            kind = kinds.get(key, Any)
            try:
                given[key] = TypeAdapter(kind, config=_STRICT).validate_python(_tuples(value))
            except ValidationError:
                accepted = re.sub(
                    r"tuple\[(\w+), \.\.\.\]", r"a list of \1", formatannotation(kind)
                )
                accepted = accepted.replace(" | ", " or ")
                raise BadInput(f"{key} = {value!r}: expected {accepted}") from None
        if given.get("lambda_part") is not None:
            choose("lambda_part", given["lambda_part"], names())
        check({key: given[key] for key in TUNING if key in given})
        return self


def _tuples(value: Any) -> Any:
    """Lists, which is all that TOML has, as tuples, and numpy's values as Python's."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(_tuples(v) for v in value) if isinstance(value, list | tuple) else value
