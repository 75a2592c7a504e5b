"""Validation of a scene's tables with messages of the form ``<key> = <value>: expected ...``."""

from __future__ import annotations

import inspect
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from textwrap import fill, indent
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput, bad_value, shown, suggestion_for, unknown_name

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]


def _check_largest(value: float) -> float:
    """Return a number; reject one whose square could overflow."""
    if abs(value) > LARGEST_NUMBER:
        raise PydanticCustomError("too_large", "")
    return value


def _check_smallest(value: float) -> float:
    """Return a number; reject a positive one whose square could underflow."""
    if 0 < value < 1 / LARGEST_NUMBER:
        raise PydanticCustomError("too_small", "")
    return value


#: A number that is computed with: a length, a force, a time.
Bounded = Annotated[Finite, AfterValidator(_check_largest)]
#: A positive number that divides or is squared.
BoundedPositive = Annotated[Bounded, Field(gt=0), AfterValidator(_check_smallest)]
#: What `Expect` appends to its message, by the error type of the two checks above.
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


class Expect:
    """An annotation that states what a field accepts; it replaces pydantic's own messages.

    Numpy's scalars and arrays are converted to numbers and lists. UFL expressions are rejected.
    """

    def __init__(self, what: str) -> None:
        self.what = what

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
        """Return the field's value for a UFL expression or a list with one; here reject it."""
        raise self._error("")

    def _error(self, bounds: str) -> PydanticCustomError:
        """Return the exception whose message is what is accepted, followed by ``bounds``."""
        return PydanticCustomError("expected", "expected {what}", {"what": self.what + bounds})


class ExpectExpression(Expect):
    """An annotation for numbers that may be a UFL expression in a program.

    A list with UFL expressions becomes a vector of UFL. ``ranks`` are the ranks of tensors that the
    expression may have.
    """

    def __init__(self, what: str, ranks: tuple[int, ...] = (0,)) -> None:
        super().__init__(what)
        self._ranks = ranks

    def _expression(self, value: Any) -> Any:
        given = value if is_expression(value) else sys.modules["ufl"].as_vector(value)
        if len(given.ufl_shape) not in self._ranks:
            kinds = " or ".join(("scalar", "vector")[rank] for rank in self._ranks)
            raise self._error(f", or a UFL expression, a {kinds}")
        return given


class Whole(Expect):
    """An annotation for whole numbers from ``lowest`` to ``highest``."""

    def __init__(self, lowest: int, highest: int) -> None:
        super().__init__(f"a whole number from {lowest} to {highest}")
        self.lowest, self.highest = lowest, highest

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        numbers = core_schema.int_schema(strict=True, ge=self.lowest, le=self.highest)
        return core_schema.no_info_wrap_validator_function(self._check, numbers)


class OneOf(Expect):
    """An annotation for a text that is one of ``words``."""

    def __init__(self, words: Iterable[str]) -> None:
        self.words = tuple(words)
        super().__init__(f"one of {', '.join(self.words)}")

    def _check(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        word = super()._check(value, inner)
        if word not in self.words:
            raise self._error(suggestion_for(word, self.words))
        return word


class _TableClass(ModelMetaclass):
    """The metaclass of `Table`: ``dir`` leaves out names of pydantic's and private names."""

    def __dir__(cls) -> list[str]:
        names = super().__dir__()
        return [name for name in names if not (name.startswith("_") or hasattr(BaseModel, name))]


class Table(BaseModel, metaclass=_TableClass):
    """A table with known keys; messages name unknown and missing ones.

    A key is set if its value is not its default.

    Attributes
    ----------
    one_of : tuple of str
        Keys of which exactly one must be set.
    excludes : mapping of str to tuple of str
        By key, the keys that must not be set beside it.
    needs : mapping of str to tuple of str
        By key, the keys of which at least one must be given beside it, as the key acts on their
        values only. "a.b" is the key b of the table a in this table.
    needs_value : mapping of str to (str, str)
        By key, another key and the value that this other key must have.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    one_of: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    needs: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    needs_value: ClassVar[Mapping[str, tuple[str, str]]] = {}

    def __init__(self, *values: Any, **keys: Any) -> None:
        """Set the first keys of `positional_fields` to ``values``, and other keys by name.

        Raises
        ------
        BadInput
            For a value that is not accepted, an unknown or a missing key.
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

    # Without this pydantic calls __init__ for tables in tables, too, and the errors of those tables
    # lose their keys. Type checkers know no attributes of functions.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def positional_fields(cls) -> list[str]:
        """Return the fields' names: those of the class first, then those of its bases."""
        own = [*cls.__annotations__, *cls.model_fields]
        return [key for key in dict.fromkeys(own) if key in cls.model_fields]

    @property
    def files(self) -> dict[str, Path]:
        """The paths among the values of the table and of the tables in it, by dotted keys."""
        return _files([(key, getattr(self, key)) for key in type(self).model_fields])

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: Any) -> Any:
        """Return the data; raise BadInput for an unknown or a missing key."""
        if not isinstance(data, dict):
            return data
        fields = cls.model_fields
        for key in data:
            if key not in fields and cls.model_config["extra"] == "forbid":
                known = cls.positional_fields()
                raise unknown_name("key", key, known, suggestion(key, known))
        for key, field in fields.items():
            if field.is_required() and key not in data:
                what = [m.what for m in field.metadata if isinstance(m, Expect)]
                described = (field.description or "a value").rstrip(".")
                what = what or [described[0].lower() + described[1:]]
                raise BadInput(f"missing key '{key}': expected {what[0]}")
        return data

    @model_validator(mode="after")
    def _check_rules(self) -> Self:
        """Return the table; raise BadInput for keys that exclude each other or have no effect."""
        if self.one_of and len(given := [key for key in self.one_of if self._is_set(key)]) != 1:
            found = ", ".join(given) or "none"
            raise BadInput(f"expected one of the keys {', '.join(self.one_of)}; found {found}")
        for key, others in self.excludes.items():
            for other in filter(self._is_set, others if self._is_set(key) else ()):
                raise BadInput(f"'{key}' and '{other}' exclude each other: expected one of them")
        for key, others in self.needs.items():
            if self._is_set(key) and not any(map(self._is_given, others)):
                missing = "', '".join(others[:-1]) + "' or '" * (len(others) > 1) + others[-1]
                raise BadInput(f"missing key '{missing}': expected with '{key}'")
        for key, (other, wanted) in self.needs_value.items():
            if self._is_set(key) and (value := getattr(self, other)) != wanted:
                accepted = f"no value, as the {other} is {value}"
                raise bad_value(key, getattr(self, key), accepted)
        return self

    @property
    def given_key(self) -> str:
        """The key of `one_of` that is set."""
        return next(filter(self._is_set, self.one_of))

    def _is_set(self, key: str) -> bool:
        """Return whether the value of a key is not its default."""
        value, default = getattr(self, key), type(self).model_fields[key].default
        # A measure of UFL cannot be compared with None.
        return value is not default if default is None else bool(value != default)

    def _is_given(self, key: str) -> bool:
        """Return whether a key, or "a.b" for b in a, was given a value other than None or []."""
        first, _, rest = key.partition(".")
        value = getattr(self, first)
        if rest:
            return isinstance(value, Table) and value._is_given(rest)
        return first in self.model_fields_set and value is not None and value != []


def _files(values: Iterable[tuple[Any, Any]]) -> dict[str, Path]:
    """Return the paths among (key, value) pairs, and in their tables and lists, by dotted key."""
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
    "too_short": "expected at least one table",
    "list_type": "expected a list of tables, [[...]] in TOML",
    "model_type": "expected a table",
    "float_type": "expected a number",
    "int_type": "expected a whole number",
    "string_type": "expected a text",
}


def one_line(error: ValidationError) -> str:
    """Return the first mistake as one line: ``material.nu = 0.6: expected ...``."""
    first = error.errors(include_url=False)[0]
    # Tags in brackets distinguish the kinds of mesh, material and motion.
    where = [str(part) for part in first["loc"] if not str(part).startswith("<")]
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


def check_distinct(key: str, names: Sequence[str], each: str) -> None:
    """Raise BadInput if a name occurs twice; ``each`` names the thing, for example "table"."""
    for name in names:
        if names.count(name) > 1:
            raise bad_value(key, name, f"a different name for each {each}")


# --- the texts of fields -------------------------------------------------------------------------

#: Width of the text of `with_parameters` in characters, as of the package's docstrings.
_WIDTH = 96
#: The words for types of Python.
_TYPES = {bool: "true or false", int: "a whole number", str: "a text", Path: "a path"}


def with_parameters(table: type[Table]) -> str:
    """Return the docstring of a table with its fields as the section "Parameters"."""
    lines = [inspect.cleandoc(table.__doc__ or ""), "", "Parameters", "----------"]
    for name in table.positional_fields():
        field = table.model_fields[name]
        default = "" if field.is_required() else f", default {field.get_default()!r}"
        lines.append(f"{name} : {accepted(field)}{default}")
        lines.append(indent(fill(field.description or "", _WIDTH), "    "))
    return "\n".join(lines)


def accepted(field: FieldInfo) -> str:
    """Return what a key accepts, as in its error messages, or the type of its values, or ""."""
    parts = [part for given in (*field.metadata, field.annotation) for part in _parts(given)]
    if expected := [part.what for part in parts if isinstance(part, Expect)]:
        return expected[0]
    if tables := {is_list for is_list, _ in tables_in(field.annotation)}:
        return " or ".join(
            "a list of tables" if is_list else "a table" for is_list in sorted(tables)
        )
    return next((_TYPES[part] for part in parts if part in tuple(_TYPES)), "")


def _parts(annotation: Any) -> list[Any]:
    """Return an annotation, then its metadata and type arguments, recursively."""
    inner = [*getattr(annotation, "__metadata__", ()), *get_args(annotation)]
    return [annotation, *(part for each in inner for part in _parts(each))]


def tables_in(annotation: Any, is_list: bool = False) -> list[tuple[bool, type[Table]]]:
    """Return pairs (is in a list, class) of the table classes in the type of a key."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return [(is_list, annotation)]
    is_list = is_list or get_origin(annotation) is list
    return [found for part in get_args(annotation) for found in tables_in(part, is_list)]


# --- words of other programs ---------------------------------------------------------------------


@cache
def words_of_others() -> dict[str, Any]:
    """Return the content of ``words.toml``: words of other programs, and their replacements.

    An entry of ``names`` has ``words`` of other programs and ``here``, the names in this program: a
    table of the scene in brackets, a text with an equals sign to write in the scene, or a key of
    any table. An entry of ``absent`` has ``words`` for a feature that this program lacks, and
    ``instead``, a sentence that says so.
    """
    return tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for a word of another program, or ``""``.

    For a feature that this program lacks, a sentence in the parentheses says so.

    Parameters
    ----------
    word : str
        An unknown key.
    known : iterable of str
        The keys of its table.
    """
    plain = word.strip().lower().replace("-", "_").replace(" ", "_")
    known = set(known)
    here = [
        name
        for entry in words_of_others()["names"]
        if plain in entry["words"].split()
        for name in entry["here"]
    ]
    found = [f"'{name}'" for name in here if name in known]
    found = found or [name for name in here if name.startswith("[") or "=" in name]
    if found:
        return f" (did you mean {' or '.join(dict.fromkeys(found))}?)"
    absent = words_of_others()["absent"]
    return next((f" ({e['instead']})" for e in absent if plain in e["words"].split()), "")
