"""The tables ``[material]`` and ``[[material]]`` of a scene: energy densities and moduli."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    ConfigDict,
    Discriminator,
    Field,
    SerializationInfo,
    Tag,
    field_validator,
    model_serializer,
    model_validator,
)

from fem_snh.errors import BadInput, bad_value, unknown_name
from fem_snh.materials import TUNING, defaults, files, function, label, names_in_literature, pins
from fem_snh.materials.numbers import numbers_of, store, stored, stored_key
from fem_snh.materials.parameters import (
    LARGEST_MODULUS,
    check,
    check_keywords,
    default_variants,
    plain,
)
from fem_snh.materials.registry import built_in
from fem_snh.tables.types import GroupKey, Positive
from fem_snh.tables.validation import Expect, Finite, Table, suggestion

#: Keys that only some materials have.
_OPTIONAL = ("group", "density")


class MaterialChoice(Table):
    """The material of a scene, or one of several that fill groups of volumes.

    Further keys are the material's shape parameters, the constants [Pa] that may be prescribed if
    the material has more than two, and the keywords of every material (`fem_snh.materials.TUNING`).

    Attributes
    ----------
    name : str or callable
        A name of `fem_snh.materials()`, a reference ``FILE.py:FUNCTION``, or, from Python, the
        function itself.
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    group : str, int or None
        The physical group of volumes of this material; None for all cells without another material.
    density : float or None
        Mass per reference volume [kg/m^3].
    """

    model_config = ConfigDict(extra="allow")  # `_check_parameters` validates them

    name: Annotated[Any, Expect("the name of a material, see `fem-snh materials`")] = Field(
        description="Name of the material, one that `fem-snh materials` lists, or FILE.py:FUNCTION."
    )
    E: Annotated[
        Finite,
        Field(ge=1 / LARGEST_MODULUS, le=LARGEST_MODULUS),
        Expect(f"a number from {1 / LARGEST_MODULUS:g} to {LARGEST_MODULUS:g} (Young's modulus)"),
    ] = Field(description="Young's modulus at small strain [Pa].")
    nu: Annotated[
        Finite,
        Field(gt=-1, le=0.5),
        Expect("a number in (-1, 0.5]; 0.5 itself takes a Taylor-Hood element"),
    ] = Field(description="Poisson's ratio at small strain; 0.5 requires a Taylor-Hood element.")

    group: GroupKey | None = Field(
        default=None,
        description="Physical group of volumes that the material fills, by name or number; "
        "default: all cells that are in no other material's group.",
    )
    density: Positive | None = Field(
        default=None, description="Mass per reference volume [kg/m^3], for gravity and modes."
    )

    @property
    def parameters(self) -> dict[str, Any]:
        """The further keys, e.g. ``{"barrier": True, "alpha": 2.0}``."""
        return dict(self.model_extra or {})

    def default_variants(self) -> dict[str, Any]:
        """Return the defaults of parameters that select a variant by nu and are not given."""
        return default_variants(function(self.name), self.nu, self.parameters)

    @property
    def label(self) -> str:
        """The name of the material as text."""
        return label(self.name)

    @property
    def files(self) -> dict[str, Path]:
        """The Python files in which ``name`` and ``lambda_part`` are defined, by these keys.

        Built-in names and functions have no file.
        """
        keys = {"name": self.name, "lambda_part": self.parameters.get("lambda_part")}
        return {key: path for key, value in keys.items() for path in files(value)}

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: Any) -> Any:
        _check_material("name", name)
        return name

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, table: Any) -> Any:
        """Return the table; if E or nu is missing, both follow from the material's constants."""
        if not isinstance(table, dict) or not {"E", "nu"} - table.keys():
            return table
        given = {k: v for k, v in table.items() if k not in cls.model_fields}
        return table | _moduli_of(table.get("name"), table.get("E"), table.get("nu"), given)

    @model_validator(mode="after")
    def _check_parameters(self) -> MaterialChoice:
        given = {key: plain(value) for key, value in (self.model_extra or {}).items()}
        if stored(self.name, self.E, self.nu, **given):
            return self  # only valid parameters are stored
        constants = [*pins(self.name), *names_in_literature(self.name)]
        known = [*type(self).model_fields, *defaults(self.name), *constants, *TUNING]
        given = self.model_extra or {}
        for key in given:
            if key not in known:
                raise unknown_name("parameter", key, known, suggestion(key, known))
        given |= check_keywords(function(self.name), given)
        if given.get("lambda_part") is not None:
            _check_material("lambda_part", given["lambda_part"])
        check({key: given[key] for key in TUNING if key in given})
        return self

    @model_serializer(mode="plain")
    def _serialized(self, info: SerializationInfo) -> dict[str, Any]:
        """Return the table without unset optional keys; JSON has a function's name in its place."""
        table = {"name": self.name, "E": self.E, "nu": self.nu} | self.parameters
        table |= {key: v for key in _OPTIONAL if (v := getattr(self, key)) is not None}
        if info.mode == "json":
            return {key: label(v) if callable(v) else v for key, v in table.items()}
        return table


def _check_material(key: str, name: Any) -> None:
    """Raise BadInput unless ``name``, the value of ``key``, is a material."""
    if not (callable(name) or isinstance(name, str)):
        raise bad_value(key, name, "the name of a material, see `fem-snh materials`")
    if isinstance(name, str) and name in built_in():
        return  # the function would import sympy
    try:
        function(name)
    except BadInput as error:
        raise BadInput(str(error).replace("material =", f"{key} =", 1)) from None


def _moduli_of(name: Any, E: Any, nu: Any, given: Mapping[str, Any]) -> dict[str, float]:
    """Return the E and nu that a material's constants in ``given`` determine, or {}."""
    from fem_snh.materials.making import make_energy, with_moduli  # imports sympy

    keywords = {key: plain(value) for key, value in given.items()}
    numbers = stored(name, E, nu, **keywords)
    if numbers is None:
        try:
            constants = {*pins(name), *names_in_literature(name)}
        except BadInput:  # `_check_name` reports it
            return {}
        if not any(keywords.get(key) is not None for key in constants):
            return {}
        young, ratio, _ = with_moduli(name, E, nu, keywords)
        energy = make_energy(name, young, ratio, **keywords)
        numbers = numbers_of(energy, stored_key(name, E, nu, keywords))
        store(numbers)
    return {"E": numbers.E, "nu": numbers.nu}


def _check_materials(
    materials: MaterialChoice | list[MaterialChoice],
) -> MaterialChoice | list[MaterialChoice]:
    """Return the materials; a list of one becomes its entry.

    Raises BadInput for an empty list, and for materials that fill the same cells.
    """
    if isinstance(materials, MaterialChoice):
        return materials
    if not materials:
        raise bad_value("material", [], "at least one table")
    groups = [material.group for material in materials]
    if groups.count(None) > 1:
        raise BadInput("missing key 'group': expected in all materials but one")
    for group in groups:
        if [str(other) for other in groups].count(str(group)) > 1:
            raise bad_value("group", group, "another group for each material")
    return materials[0] if len(materials) == 1 else materials


def _tag(value: Any) -> str:
    return "<several>" if isinstance(value, list | tuple) else "<one>"


#: One material, or a list of several.
Materials = Annotated[
    Annotated[MaterialChoice, Tag("<one>")] | Annotated[list[MaterialChoice], Tag("<several>")],
    Discriminator(_tag),
    AfterValidator(_check_materials),
]
