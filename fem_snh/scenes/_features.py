"""The features that scenes have as tables: the program's own, and those of other packages."""

from __future__ import annotations

import warnings
from typing import Annotated, Any

from pydantic import BeforeValidator
from pydantic.fields import FieldInfo

from fem_snh.errors import BadInput, bad_value
from fem_snh.records.output_fields import add_nodal_fields
from fem_snh.references import entry_points
from fem_snh.scenes.schema import Scene
from fem_snh.terms.feature import Feature

#: Entry point group under which a package declares features, each under the key of its table.
FEATURES = "fem_snh.features"
#: The program's own keys of a scene, which no package replaces.
_OWN = frozenset(Scene.model_fields)


def register_feature(feature: type[Feature]) -> type[Feature]:
    """Make a feature a list of tables of scenes, ``[[key]]`` in TOML. It is a decorator, too.

    Packages declare it as an entry point of the group ``fem_snh.features`` instead, under its key.

    Parameters
    ----------
    feature : type
        A subclass of `fem_snh.terms.feature.Feature` with a ``key`` that scenes do not have yet.

    Raises
    ------
    BadInput
        For anything else.
    """
    if not (isinstance(feature, type) and issubclass(feature, Feature)):
        raise bad_value("feature", feature, "a subclass of fem_snh.Feature")
    key = getattr(feature, "key", None)
    if not isinstance(key, str) or not key.isidentifier() or key in _OWN:
        raise bad_value(f"{feature.__name__}.key", key, "the key of a table that no scene has yet")
    summary = (feature.__doc__ or key).strip().partition("\n")[0]
    _add(key, list[feature], summary)  # type: ignore[valid-type]  # a type of the run time
    add_nodal_fields(feature.nodal_fields)
    return feature


def _add(key: str, annotation: Any, description: str | None = None) -> None:
    """Add a key of an annotated type to scenes, by default an empty list."""
    Scene.model_fields[key] = FieldInfo(annotation=annotation, default=[], description=description)
    Scene.model_rebuild(force=True)


def _register_entry_points() -> None:
    """Register the features of other packages; the table of a broken one raises its error."""
    for key, load in entry_points(FEATURES).items():
        if key in _OWN:  # scenes must run as without the package
            warnings.warn(
                f"the entry point '{key}' of {FEATURES} is no table: that key is the program's own",
                stacklevel=2,
            )
            continue
        try:
            found: Any = load()
            if getattr(found, "key", key) != key:
                raise bad_value(f"entry point {key}", found, f"a feature with the key '{key}'")
            register_feature(found)
        except BadInput as error:
            _add(key, Annotated[Any, _refuse(error)])


def _refuse(error: BadInput) -> BeforeValidator:
    """Return a validator that raises an error for any table."""

    def check(value: object) -> object:
        if value != []:
            raise error
        return value

    return BeforeValidator(check)


_register_entry_points()
