"""Validated tables whose mistakes read well: one line with the key, the value and what would do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fem_snh.errors import BadInput, unknown_name

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]


@dataclass(frozen=True)
class Expect:
    """Says what a field expects, in place of pydantic's own messages; takes numpy's values too."""

    what: str

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_wrap_validator_function(self._check, handler(source))

    def _check(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        try:
            return inner(value.tolist() if hasattr(value, "tolist") else value)
        except ValidationError:
            raise PydanticCustomError("expected", "expected {what}", {"what": self.what}) from None


class Table(BaseModel):
    """A table with known keys: an unknown one names the nearest, a missing one what it takes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _keys(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        fields = cls.model_fields
        for key in data:
            if key not in fields and cls.model_config["extra"] == "forbid":
                raise unknown_name("key", key, fields)
        for key, field in fields.items():
            if field.is_required() and key not in data:
                what = [f": expected {m.what}" for m in field.metadata if isinstance(m, Expect)]
                raise BadInput(f"missing key '{key}'{''.join(what)}")
        return data


_KINDS = {
    "list_type": "expected a list of tables, [[...]] in TOML",
    "model_type": "expected a table",
    "float_type": "expected a number",
    "int_type": "expected a whole number",
}


def one_line(error: ValidationError) -> str:
    """The first mistake of a ValidationError in one line: ``material.nu = 0.5: expected ...``."""
    first = error.errors(include_url=False)[0]
    # "built-in" and "file" are the tags by which Scene.mesh tells its two kinds apart.
    where = ".".join(str(part) for part in first["loc"] if part not in ("built-in", "file"))
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, BadInput):
        return f"{where}: {cause}" if where else str(cause)
    value = repr(first["input"])
    value = value if len(value) <= 60 else value[:57] + "..."
    what = _KINDS.get(first["type"]) or first["msg"].removeprefix("Input ")
    what = what.replace("should be", "expected")
    return f"{where} = {value}: {what}"
