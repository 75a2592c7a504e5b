"""Load a scene: by name, from a file or a function, with some of its values replaced."""

from __future__ import annotations

import inspect
import pkgutil
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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

#: Largest number of tables' keys that a message suggests: many tables have a key `group`.
_MOST_SUGGESTED = 4
#: Short names of keys of the material's table.
_SHORT = {"material": "material.name", "E": "material.E", "nu": "material.nu"}


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
        ``petsc`` is merged with the scene's options. None leaves a value unchanged. A new material
        drops the old one's shape parameters. In a scene with several materials, ``material``,
        ``E``, ``nu`` and ``material.KEY`` change each of them, ``material.0.KEY`` the first.

    Raises
    ------
    BadInput
        One line that names the scene, the key, its value and what is accepted.
    """
    given = {key: value for key, value in overrides.items() if value is not None or "." in key}
    given = {key: v.tolist() if hasattr(v, "tolist") else v for key, v in given.items()}
    if isinstance(scene, Scene):
        return validate(_tables(scene), scene.name, given) if given else scene
    if callable(scene):
        return _call(scene, getattr(scene, "__name__", "scene"), given)
    label = str(scene)
    if label.endswith(".toml"):
        return validate(read_toml(Path(scene)), label, given)
    return _call(function(label), label, given)


def load_to_run(scene: str | Path | Scene | Callable[..., Scene], /, **overrides: Any) -> Scene:
    """Return the scene of `load`; raise BadInput also for a probe radius that no goal uses."""
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
    with _named(label):
        keys = dict.fromkeys([*(known or {}), *_SHORT, *Scene.model_fields])
        for key in overrides:
            if (first := key.partition(".")[0]) not in keys:
                near = _key_of_a_table(first) or suggestion(first, keys)
                raise unknown_name("parameter", first, keys, near)
        return Scene.model_validate(_replaced(dict(data), overrides))


@contextmanager
def _named(label: str) -> Iterator[None]:
    """Provide a context whose errors become BadInput of one line, which starts with ``label``."""
    try:
        yield
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
    """Return the tables of a scene file; raise BadInput if it cannot be read.

    Relative paths in the file become relative to the working directory. The default of the key
    ``name`` is the file's stem.
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
    """Return the Scene that a function makes, with some of its values replaced.

    The arguments of the function are removed from ``given``; the other entries replace values.
    """
    own = parameters(make)
    arguments = {key: given.pop(key) for key in own if key in given}
    with _named(label):
        made = make_scene(make, arguments)
    if not given and not is_reference(label):
        return made
    data = _tables(made)
    if is_reference(label):
        data = _starting_from(Path(label.rpartition(":")[0]).parent, data)
    return validate(data, label, given, own)


def _tables(scene: Scene) -> dict[str, Any]:
    """Return all keys of a scene; its tables have only the given keys: see `Table.needs`."""
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


def _replaced(data: dict[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a scene with overrides applied; changed tables and lists are copies."""
    of_materials: list[tuple[list[str], Any]] = []
    for key, value in _dotted(data, overrides):
        first, *way = key.split(".", 1) if key.startswith("petsc.") else key.split(".")
        if first == "material" and way:
            of_materials.append((way, value))
        else:
            data = _with(data, [first, *way], value, key)
    if of_materials:
        materials = data.get("material")
        several = isinstance(materials, list)
        listed = materials if isinstance(materials, list) else [materials or {}]
        for way, _ in of_materials:
            if way[0].isdigit() and int(way[0]) >= len(listed):
                raise _unknown_key(".".join(["material", *way]))
        made = [_changed(m, number, of_materials) for number, m in enumerate(listed)]
        data = data | {"material": made if several else made[0]}
    return data


def _dotted(data: Mapping[str, Any], overrides: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of each override.

    Raises
    ------
    BadInput
        For a key that is given under two names.
    """
    given: dict[str, str] = {}
    for key, value in overrides.items():
        pairs = {_SHORT.get(key, key): value}
        if key in ("material", "petsc") and isinstance(value, Mapping):
            pairs = {f"{key}.{inner}": entry for inner, entry in value.items()}
        elif key == "material" and isinstance(value, list):
            pairs = {key: value}
        elif key == "steps" and (data.get("time") or "time" in overrides):
            pairs = {"time.steps": value}  # in a scene in time, --steps means its time steps
        for dotted, entry in pairs.items():
            # A static scene that is given a [time] is given its one step, too.
            same = "time.steps" if dotted == "steps" and entry != 1 else dotted
            if (other := given.setdefault(same, key)) != key:
                raise BadInput(f"{other} and {key}: expected one of them")
            yield dotted, entry


def _with(data: Any, way: Sequence[str], value: Any, key: str) -> Any:
    """Return tables with ``value`` at the path of keys ``way``; missing tables are created.

    BadInput names ``key`` if there is no such path.
    """
    if not way:
        return value
    first, *rest = way
    try:
        if isinstance(data, list):
            copied = list(data)
            copied[int(first)] = _with(copied[int(first)], rest, value, key)
            return copied
        table = {} if data is None else data
        return table | {first: _with(table.get(first), rest, value, key)}
    except (IndexError, ValueError, TypeError, AttributeError) as error:
        if isinstance(error, BadInput):
            raise
        raise _unknown_key(key) from None


def _unknown_key(key: str) -> BadInput:
    return BadInput(f"unknown key '{key}': expected a key of a table of the scene")


def _changed(material: Any, number: int, changes: Sequence[tuple[list[str], Any]]) -> Any:
    """Return the table of a material with the changes of all materials, and of material ``number``.

    A new name drops the old material's parameters; new constants drop an E or nu that they replace.
    """
    own = [(way, value) for way, value in changes if not way[0].isdigit()]
    own += [(way[1:], value) for way, value in changes if way[0] == str(number)]
    for way, value in own:
        if way == ["name"] and isinstance(material, dict) and material.get("name") != value:
            material = {k: material[k] for k in MaterialChoice.model_fields if k in material}
    for way, value in own:
        material = _with(material, way, value, ".".join(["material", *way]))
    given = {way[0] for way, value in own if way and value is not None}
    if given - {*MaterialChoice.model_fields, *TUNING}:
        return _without_replaced(material, given)
    return material


def _without_replaced(material: dict[str, Any], given: set[str]) -> dict[str, Any]:
    """Return a material's table without the E and nu that its new constants replace."""
    from fem_snh.materials import names_in_literature, pins

    try:
        constants = {*pins(material["name"]), *names_in_literature(material["name"])}
    except (KeyError, BadInput):  # it is reported where the table is validated
        return material
    if not constants & given:
        return material
    from fem_snh.materials.making import Incomplete, drop_determined_moduli  # imports sympy

    own = {k: v for k, v in material.items() if k not in MaterialChoice.model_fields}
    try:
        return drop_determined_moduli(material, given, own)
    except Incomplete:
        raise
    except BadInput:  # it is reported where the table is validated
        return material


# --- functions that make scenes ------------------------------------------------------------------

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
    """Return the scene that a function makes from validated arguments.

    Raises
    ------
    ValidationError
        If a value of an argument, or of a table that the function makes, is not accepted.
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


# --- features of other packages ------------------------------------------------------------------

#: Entry point group under which a package declares features, each under the key of its table.
FEATURES = "fem_snh.features"
#: The program's own keys of a scene, which no package replaces.
_OWN = frozenset(Scene.model_fields)


def register_feature(feature: type[Feature]) -> type[Feature]:
    """Make a feature a list of tables of scenes, ``[[key]]`` in TOML; return the feature.

    Packages declare it as an entry point of the group ``fem_snh.features`` instead, under its key.

    Parameters
    ----------
    feature : type
        A subclass of `fem_snh.terms.feature.Feature` with a ``key`` that scenes do not have yet.

    Raises
    ------
    BadInput
        For another object or key.
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
    """Register the features of other packages.

    If a feature is broken, a scene with its table raises the error.
    """
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
    """Return a validator that raises an error for any value but an empty list."""

    def check(value: object) -> object:
        if value != []:
            raise error
        return value

    return BeforeValidator(check)


_register_entry_points()
