"""Validation of a scene's tables with messages of the form ``<key> = <value>: expected ...``."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput, choose, shown, unknown_name
from fem_snh.tables.synonyms import suggestion

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]


def _check_largest(value: float) -> float:
    """Reject a number whose squares could overflow in what is computed from it."""
    if abs(value) > LARGEST_NUMBER:
        raise PydanticCustomError("too_large", "")
    return value


def _check_smallest(value: float) -> float:
    """Reject a positive number whose squares could underflow."""
    if 0 < value < 1 / LARGEST_NUMBER:
        raise PydanticCustomError("too_small", "")
    return value


#: A number that is computed with: a length, a force, a time.
Bounded = Annotated[Finite, AfterValidator(_check_largest)]
#: The same, where it divides or is squared.
BoundedPositive = Annotated[Bounded, Field(gt=0), AfterValidator(_check_smallest)]
#: What the message of `Expect` adds for the errors of these checks.
_BOUNDS = {
    "too_large": f", of a size up to {LARGEST_NUMBER:g}",
    "too_small": f", of a size from {1 / LARGEST_NUMBER:g}",
}


def is_expression(value: object) -> bool:
    """Return whether a value is a UFL expression, such as a Constant or a Function of dolfinx."""
    kinds = sys.modules.get("ufl.core.expr")
    return kinds is not None and isinstance(value, kinds.Expr)


def _has_expressions(value: object) -> bool:
    """Return whether a value is a UFL expression, or a list with one."""
    return is_expression(value) or (
        isinstance(value, list | tuple) and any(map(is_expression, value))
    )


@dataclass(frozen=True)
class Expect:
    """An annotation that states what a field accepts; it replaces pydantic's own messages.

    Numpy's scalars and arrays are accepted as Python's, and no UFL expressions.
    """

    what: str

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_wrap_validator_function(self._check, handler(source))

    def _check(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        if _has_expressions(value):  # pydantic calls float() of one, which calls itself
            return self._expression(value)
        try:
            return inner(value.tolist() if hasattr(value, "tolist") else value)
        except ValidationError as error:
            kinds = [_BOUNDS.get(found["type"], "") for found in error.errors()]
            raise self._error(next(filter(None, kinds), "")) from None
        except OverflowError:  # a whole number too large for a float
            raise self._error(_BOUNDS["too_large"]) from None

    def _expression(self, value: Any) -> Any:
        """Return a UFL expression, or a list with one, as the field's value, or reject it."""
        raise self._error("")

    def _error(self, bounds: str) -> PydanticCustomError:
        """Return the exception that states what is accepted."""
        return PydanticCustomError("expected", "expected {what}", {"what": self.what + bounds})


@dataclass(frozen=True)
class ExpectExpression(Expect):
    """An annotation for numbers that may be a UFL expression in a program.

    A list with UFL expressions becomes a vector of UFL.

    Attributes
    ----------
    ranks : tuple of int
        The ranks of tensors that the expression may have.
    """

    ranks: tuple[int, ...] = (0,)

    def _expression(self, value: Any) -> Any:
        given = value if is_expression(value) else sys.modules["ufl"].as_vector(value)
        if len(given.ufl_shape) not in self.ranks:
            kinds = " or ".join(("scalar", "vector")[rank] for rank in self.ranks)
            raise self._error(f", or a UFL expression, a {kinds}")
        return given


@dataclass(frozen=True, init=False)
class Whole(Expect):
    """An annotation for whole numbers from ``lowest`` to ``highest``."""

    lowest: int
    highest: int

    def __init__(self, lowest: int, highest: int) -> None:
        object.__setattr__(self, "lowest", lowest)
        object.__setattr__(self, "highest", highest)
        object.__setattr__(self, "what", f"a whole number from {lowest} to {highest}")

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        numbers = core_schema.int_schema(strict=True, ge=self.lowest, le=self.highest)
        return core_schema.no_info_wrap_validator_function(self._check, numbers)


@dataclass(frozen=True, init=False)
class OneOf(Expect):
    """An annotation for one of some words, the value of a key."""

    key: str
    words: tuple[str, ...]

    def __init__(self, key: str, words: Iterable[str]) -> None:
        object.__setattr__(self, "key", key)
        object.__setattr__(self, "words", tuple(words))
        object.__setattr__(self, "what", f"one of {', '.join(self.words)}")

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        text = super().__get_pydantic_core_schema__(source, handler)
        return core_schema.no_info_after_validator_function(self._choose, text)

    def _choose(self, word: str) -> str:
        return choose(self.key, word, self.words)


class _TableClass(ModelMetaclass):
    """The class of tables, of which ``help`` and completion leave out what is pydantic's."""

    def __dir__(cls) -> list[str]:
        names = super().__dir__()
        return [name for name in names if not (name.startswith("_") or hasattr(BaseModel, name))]


class Table(BaseModel, metaclass=_TableClass):
    """A table with known keys; messages name unknown and missing ones.

    Attributes
    ----------
    needs : mapping of str to tuple of str
        Keys that act on others alone, with these: without one of them they would have no effect,
        and are refused. A dotted one is a key of a table in the table.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    needs: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def __init__(self, *values: Any, **keys: Any) -> None:
        """Set the first keys to ``values``, in their order, and others by name.

        Raises
        ------
        BadInput
            One line, for a value that is not accepted, an unknown or a missing key.
        """
        fields, name = self.positional_fields(), type(self).__name__
        if len(values) > len(fields):
            accepted = f"at most {len(fields)}: {', '.join(fields)}"
            raise BadInput(f"{name} with {len(values)} values: expected {accepted}")
        given = dict(zip(fields, values, strict=False))
        if twice := [key for key in given if key in keys]:
            raise BadInput(f"{name}: expected one value of '{twice[0]}', not two")
        try:
            super().__init__(**given, **keys)
        except ValidationError as error:
            raise BadInput(one_line(error)) from None

    # Otherwise pydantic calls it for tables in tables, too, and their errors lose their keys. Type
    # checkers know no attributes of functions.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def positional_fields(cls) -> list[str]:
        """Return the fields' names: those of the class first, then those of its bases."""
        own = [*cls.__annotations__, *cls.model_fields]
        return [key for key in dict.fromkeys(own) if key in cls.model_fields]

    @property
    def files(self) -> dict[str, Path]:
        """The files that it and its tables name, by dotted keys."""
        return _files([(key, getattr(self, key)) for key in type(self).model_fields])

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: Any) -> Any:
        """Raise BadInput for an unknown or a missing key."""
        if not isinstance(data, dict):
            return data
        fields = cls.model_fields
        for key in data:
            if key not in fields and cls.model_config["extra"] == "forbid":
                raise unknown_name("key", key, fields, suggestion(key, fields))
        for key, field in fields.items():
            if field.is_required() and key not in data:
                what = [m.what for m in field.metadata if isinstance(m, Expect)]
                described = (field.description or "a value").rstrip(".")
                what = what or [described[0].lower() + described[1:]]
                raise BadInput(f"missing key '{key}': expected {what[0]}")
        return data

    @model_validator(mode="after")
    def _check_needs(self) -> Self:
        """Raise BadInput for a key without those that it acts on."""
        for key, others in self.needs.items():
            default = type(self).model_fields[key].default
            if getattr(self, key) != default and not any(map(self._is_given, others)):
                missing = "', '".join(others[:-1]) + "' or '" * (len(others) > 1) + others[-1]
                raise BadInput(f"missing key '{missing}': expected with '{key}'")
        return self

    def _is_given(self, key: str) -> bool:
        """Return whether the table has a value for a key, or for one of a table in it, 'a.b'."""
        first, _, rest = key.partition(".")
        value = getattr(self, first)
        if rest:
            return isinstance(value, Table) and value._is_given(rest)
        return first in self.model_fields_set and value is not None


def _files(values: Iterable[tuple[Any, Any]]) -> dict[str, Path]:
    """Return the files among values by key, and in their tables and lists."""
    found: dict[str, Path] = {}
    for key, value in values:
        if isinstance(value, Path):
            found[str(key)] = value
        elif isinstance(value, Table | list):
            inner = value.files if isinstance(value, Table) else _files(enumerate(value))
            found |= {f"{key}.{name}": path for name, path in inner.items()}
    return found


#: Messages for pydantic's error types, where a field has no `Expect`.
_EXPECTED = {
    "list_type": "expected a list of tables, [[...]] in TOML",
    "model_type": "expected a table",
    "float_type": "expected a number",
    "int_type": "expected a whole number",
    "string_type": "expected a text",
}
#: Tags by which pydantic distinguishes the kinds of ``mesh``, ``material`` and ``motion``; messages
#: must not show them.
_TAGS = (
    "built-in", "file", "in a lattice", "of tetrahedra", "a shape", "a surface", "one material",
    "several materials", "function", "skeleton",
)  # fmt: skip


def one_line(error: ValidationError) -> str:
    """Return the first mistake as one line: ``material.nu = 0.6: expected ...``."""
    first = error.errors(include_url=False)[0]
    where = [str(part) for part in first["loc"] if part not in _TAGS]
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, BadInput):
        message = str(cause)
        if key := re.match(r"([\w.]+) = ", message):  # a validator knows its key without its table
            return ".".join([*(where[:-1] if where[-1:] == [key[1]] else where), message])
        return f"{'.'.join(where)}: {message}" if where else message
    if first["type"].startswith("missing_"):  # an argument of a scene's function
        return f"missing parameter '{'.'.join(where)}': expected a value"
    what = _EXPECTED.get(first["type"]) or first["msg"].removeprefix("Input ")
    what = what.replace("should be", "expected")
    return f"{'.'.join(where)} = {shown(first['input'])}: {what}"


def given_key(table: Table, *keys: str) -> str:
    """Return the key that a table has of several that exclude each other.

    Raises
    ------
    BadInput
        For none or more than one of them.
    """
    given = [key for key in keys if getattr(table, key) is not None]
    if len(given) != 1:
        found = ", ".join(given) or "none"
        raise BadInput(f"expected one of the keys {', '.join(keys)}; found {found}")
    return given[0]
