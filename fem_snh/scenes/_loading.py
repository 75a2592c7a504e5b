"""Load a scene: by name, from a file or a function, with some of its values replaced."""

from __future__ import annotations

import inspect
import pkgutil
import tomllib
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, ValidationError, validate_call
from pydantic.fields import FieldInfo

from fem_snh.errors import BadInput, bad_value, nearest_file, unknown_name
from fem_snh.files import read_text
from fem_snh.materials.parameters import TUNING
from fem_snh.records.output_fields import add_nodal_fields
from fem_snh.references import FileText, describe_error, entry_points, is_reference, load_reference
from fem_snh.scenes import builtin
from fem_snh.scenes._consistency import check_radii
from fem_snh.scenes.schema import MaterialChoice, Scene
from fem_snh.tables.validation import one_line, suggestion, tables_in
from fem_snh.terms.feature import Feature

#: Keys of tables that a message suggests at most: many tables have a key `group`.
_MOST_SUGGESTED = 4
#: Keys that stand for a key of the material's table.
_SHORT = {"material": "material.name", "E": "material.E", "nu": "material.nu"}
#: Keys that have another name, and that name.
_SYNONYMS = _SHORT | {"steps": "time.steps"}


def load(scene: str | Path | Scene | Callable[..., Scene], /, **overrides: Any) -> Scene:
    """Return a scene, with some of its values replaced.

    Parameters
    ----------
    scene : str, Path, Scene or callable
        A name (`names`), a path that ends in ``.toml``, a reference ``FILE.py:NAME`` to a function
        that returns a Scene, the function itself, or a Scene.
    **overrides
        Parameters of the scene's function; keys of `Scene`; ``material`` (a name or a table), ``E``
        and ``nu``; dotted keys such as ``material.barrier`` or ``move.0.translate``. A table
        ``petsc`` is merged with the scene's. None leaves a value unchanged. Another material drops
        the shape parameters of the scene's. Of a scene with several materials, ``material``, ``E``,
        ``nu`` and ``material.KEY`` change each of them, ``material.0.KEY`` the first.

    Raises
    ------
    BadInput
        One line that names the scene, the key, its value and what is accepted.
    """
    given = {key: value for key, value in overrides.items() if value is not None or "." in key}
    given = {key: v.tolist() if hasattr(v, "tolist") else v for key, v in given.items()}
    _check_given_once(given)
    if isinstance(scene, Scene):
        return validate(_tables(scene), scene.name, given) if given else scene
    if callable(scene):
        return _call(scene, getattr(scene, "__name__", "scene"), given)
    label = str(scene)
    if label.endswith(".toml"):
        return validate(read_toml(Path(scene)), label, given)
    return _call(function(label), label, given)


def _check_given_once(given: Mapping[str, Any]) -> None:
    """Raise BadInput for a key that is given under two names."""
    choice = given.get("material")
    table = choice if isinstance(choice, Mapping) else {}
    for short, long in _SYNONYMS.items():
        # A static scene that is given a [time] is given its one step, too.
        own = table if short == "material" else given.get(short) == 1 and short == "steps"
        if short in given and long in given and not own:
            raise BadInput(f"{short} and {long}: expected one of them")
    for key in table:
        for other in (key, f"material.{key}"):
            if other in given and _SYNONYMS.get(other, other) == f"material.{key}":
                raise BadInput(f"material and {other}: expected {key} in one of them")


def load_to_run(scene: str | Path | Scene | Callable[..., Scene], /, **overrides: Any) -> Scene:
    """Return the scene of `load`; raise BadInput for a key that a run does not use, too."""
    found = load(scene, **overrides)
    check_radii(found)
    return found


def validate(
    data: Mapping[str, Any],
    label: str,
    overrides: Mapping[str, Any] | None = None,
    known: Mapping[str, Any] | None = None,
) -> Scene:
    """Return the Scene that some tables define.

    Parameters
    ----------
    data : mapping
        The tables.
    label : str
        The scene's name in messages.
    overrides : mapping, optional
        Values to put into the tables, by keys as in `load`.
    known : mapping, optional
        Parameters of the scene's function, which a message about an unknown key lists.

    Raises
    ------
    BadInput
        One line, which starts with ``label``.
    """
    overrides = overrides or {}
    try:
        keys = dict.fromkeys([*(known or {}), *_SHORT, *Scene.model_fields])
        for key in overrides:
            if (first := key.partition(".")[0]) not in keys:
                near = _key_of_a_table(first) or suggestion(first, keys)
                raise unknown_name("parameter", first, keys, near)
        return Scene.model_validate(_replace(_copied(dict(data)), overrides))
    except ValidationError as error:
        raise BadInput(f"{label}: {one_line(error)}") from None
    except BadInput as error:
        raise BadInput(f"{label}: {error}") from None


def _key_of_a_table(word: str) -> str:
    """Return ``" (did you mean 'time.integrator'?)"`` for a key of a table, or ``""``."""
    found = dict.fromkeys(
        f"'{name}.{'0.' if is_list else ''}{word}'"
        for name, field in Scene.model_fields.items()
        for is_list, table in tables_in(field.annotation)
        if word in table.model_fields
    )
    return f" (did you mean {' or '.join(found)}?)" if 0 < len(found) <= _MOST_SUGGESTED else ""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a scene file.

    Relative paths in it become relative to the working directory; the name is the file's stem.
    """
    try:
        data = tomllib.loads(read_text(path))
    except UnicodeDecodeError:
        raise BadInput(f"{path} is not valid TOML: it is not UTF-8 text") from None
    except (ValueError, RecursionError) as error:  # also a number of too many digits
        raise BadInput(f"{path} is not valid TOML: {error}") from None
    except OSError as error:
        near = nearest_file(path)
        raise BadInput(f"cannot read the scene {path}: {error.strerror}{near}") from None
    return {"name": path.stem} | _starting_from(path.parent, data)


def _call(make: SceneFunction, label: str, given: dict[str, Any]) -> Scene:
    """Return the Scene that a function makes, with some of its values replaced."""
    own = parameters(make)
    arguments = {key: given.pop(key) for key in own if key in given}
    try:
        made = make_scene(make, arguments)
    except ValidationError as error:
        raise BadInput(f"{label}: {one_line(error)}") from None
    except BadInput as error:
        raise BadInput(f"{label}: {error}") from None
    if not given and not is_reference(label):
        return made
    data = _tables(made)
    if is_reference(label):
        data = _starting_from(Path(label.rpartition(":")[0]).parent, data)
    return validate(data, label, given, own)


def _tables(scene: Scene) -> dict[str, Any]:
    """Return a scene's keys, and of its tables those that were given: see `Table.needs`."""
    return scene.model_dump() | scene.model_dump(exclude_unset=True)


def _starting_from(folder: Path, value: Any) -> Any:
    """Return tables in which the paths of files and references start from ``folder``."""
    if isinstance(value, dict):
        return {key: _starting_from(folder, entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_starting_from(folder, entry) for entry in value]
    if isinstance(value, str):
        return FileText(value, folder)
    return folder / value if isinstance(value, Path) else value


def _change_each(materials: Any, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """Return the material, or the list of materials, with ``change`` applied to each table."""
    if isinstance(materials, list):
        return [_change_each(material, change) for material in materials]
    return change(materials) if isinstance(materials, dict) else materials


def _updated(material: dict[str, Any], value: Mapping[str, Any]) -> dict[str, Any]:
    """Return a material's table with other values."""
    return material | dict(value)


def _copied(value: Any) -> Any:
    """Return tables and lists of which none is the caller's."""
    if isinstance(value, dict):
        return {key: _copied(entry) for key, entry in value.items()}
    return [_copied(entry) for entry in value] if isinstance(value, list) else value


def _replace(data: dict[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Put the overrides into the tables ``data`` in place."""
    choice = overrides.get("material", {})
    name = choice.get("name") if isinstance(choice, Mapping) else choice
    if name is not None and not isinstance(name, list):
        data["material"] = _change_each(data.get("material"), lambda m: _renamed(m, name))
    for key, value in overrides.items():
        if isinstance(value, Mapping) and key == "material":
            several = isinstance(data.get(key), list)
            table = data[key] if several else data.get(key) or {}
            data[key] = _change_each(table, partial(_updated, value=value))
        elif isinstance(value, Mapping) and key == "petsc":
            table = data.get(key)
            data[key] = (table if isinstance(table, dict) else {}) | dict(value)
        elif isinstance(value, list) and key == "material":
            data[key] = value
        else:
            # In a scene in time, --steps means its time steps.
            in_time = key == "steps" and (data.get("time") or "time" in overrides)
            for long in _keys(data, "time.steps" if in_time else _SHORT.get(key, key)):
                _set_dotted(data, long, value)
    given = {key for key, value in overrides.items() if value is not None}
    given = {_SHORT.get(key, key).rpartition(".")[2] for key in given if _of_material(key)}
    given |= set(choice) if isinstance(choice, Mapping) else set()
    if given - {*MaterialChoice.model_fields, *TUNING}:
        data["material"] = _change_each(data["material"], partial(_without_replaced, given=given))
    return data


def _of_material(key: str) -> bool:
    return key in _SHORT or key.startswith("material.")


def _without_replaced(material: dict[str, Any], given: set[str]) -> dict[str, Any]:
    """Return a material's table without an E and a nu that its new constants replace."""
    from fem_snh.materials import names_in_literature, pins

    try:
        constants = {*pins(material["name"]), *names_in_literature(material["name"])}
    except (KeyError, BadInput):  # it is reported where the table is validated
        return material
    if not constants & given:
        return material
    from fem_snh.materials.making import Incomplete, replace_weak  # imports sympy

    own = {k: v for k, v in material.items() if k not in MaterialChoice.model_fields}
    try:
        return replace_weak(material, given, own)
    except Incomplete:
        raise
    except BadInput:  # it is reported where the table is validated
        return material


def _renamed(material: dict[str, Any], name: Any) -> dict[str, Any]:
    """Return the table without the parameters of a material that another one replaces."""
    kept = {key: material[key] for key in MaterialChoice.model_fields if key in material}
    return material if material.get("name") == name else kept


def _keys(data: dict[str, Any], key: str) -> list[str]:
    """Return the dotted keys that ``key`` means: ``material.E`` is E of every material."""
    table, _, rest = key.partition(".")
    materials = data.get("material")
    if table != "material" or not isinstance(materials, list) or rest[:1].isdigit():
        return [key]
    return [f"material.{number}.{rest}" for number in range(len(materials))]


def _set_dotted(data: Any, key: str, value: Any) -> None:
    """Set data[a][b][c] for the dotted key a.b.c; create missing tables on the way."""
    *way, last = key.split(".", 1) if key.startswith("petsc.") else key.split(".")
    try:
        for part in way:
            if isinstance(data, list):
                data = data[int(part)]
            else:
                if data.get(part) is None:
                    data[part] = {}
                data = data[part]
        data[int(last) if isinstance(data, list) else last] = value
    except (IndexError, ValueError, TypeError, AttributeError):
        raise BadInput(f"unknown key '{key}': expected a key of a table of the scene") from None


SceneFunction = Callable[..., Any]

#: Entry point group under which a package declares functions that return a `Scene`.
GROUP = "fem_snh.scenes"


def names() -> list[str]:
    """Return the sorted names of the scenes: built-in ones and entry points."""
    return sorted({*_builtin_names(), *entry_points(GROUP)})


def function(name: str) -> SceneFunction:
    """Return the function that makes a scene.

    Parameters
    ----------
    name : str
        One of `names`, or ``FILE.py:NAME``.

    Raises
    ------
    BadInput
        If the name is unknown, or its file or package does not import.
    """
    if is_reference(name):
        return load_reference(name)
    if name in _builtin_names():  # a package cannot replace them
        made: SceneFunction = getattr(import_module(f"{builtin.__name__}.{name}"), name)
        return made
    if name in (found := entry_points(GROUP)):
        return found[name]()
    accepted = f"one of {', '.join(names())}, a .toml file or FILE.py:NAME"
    if file := nearest_file(Path(f"{name}.toml")):
        raise bad_value("scene", name, accepted + file)
    raise bad_value("scene", name, accepted, names())


def describe(name: str) -> str:
    """Return the first line of the docstring of the function that makes a scene."""
    return (inspect.getdoc(function(name)) or "").partition("\n")[0]


def own_parameters(name: str) -> dict[str, Any]:
    """Return the parameters of the function that makes a scene, with their defaults."""
    return parameters(function(name))


def parameters(function: SceneFunction) -> dict[str, Any]:
    """Return the named parameters of a scene function with their defaults, or None."""
    return {
        key: None if parameter.default is parameter.empty else parameter.default
        for key, parameter in inspect.signature(function).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }


def make_scene(function: SceneFunction, arguments: dict[str, Any]) -> Scene:
    """Call a scene function with validated arguments and check its result.

    Raises
    ------
    ValidationError
        For an argument, or a value that the function gives a table, which is not accepted.
    BadInput
        If the function fails in another way, or returns no `Scene`.
    """
    try:
        scene = validate_call(config={"strict": True})(function)(**arguments)
    except (ValidationError, BadInput):
        raise
    except Exception as error:
        raise BadInput(describe_error(error, inspect.getsourcefile(function))) from None
    if not isinstance(scene, Scene):
        raise BadInput(f"returned {type(scene).__name__}: expected a fem_snh.scenes.Scene")
    return scene


def _builtin_names() -> set[str]:
    found = (module.name for module in pkgutil.iter_modules(builtin.__path__))
    return {name for name in found if name[0] != "_"}


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
