"""Types of the values in a scene's tables; the message of each states what it accepts."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StrictBool
from pydantic.json_schema import SkipJsonSchema

from fem_snh.errors import bad_value
from fem_snh.references import FileText, folder_of
from fem_snh.tables.validation import (
    Bounded,
    BoundedPositive,
    Expect,
    ExpectExpression,
    Finite,
    Whole,
)

#: Largest PetscInt of 32 bits, which also bounds the numbers of gmsh's physical groups.
INT32_MAX = 2**31 - 1
_DIGITS = len(str(INT32_MAX))
#: Largest whole number that TOML guarantees (TOML 1.0, "Integer").
INT64_MAX = 2**63 - 1
#: The built-in geometry with the fewest nodes has one layer of N x N cells: 6 (N + 1)^2 = 6e8
#: unknowns at this N, where PetscInt ends at 2e9. A cube reaches the end of PetscInt at N = 893.
MAX_CELLS = 10_000
#: What UFL calls the integrals of measures dx and ds.
_CELLS, _FACETS = "cell", "exterior_facet"
#: run.json has a row of some 500 bytes for each step: 0.5 GB.
MAX_STEPS = 1_000_000


def split_numbers(values: object) -> object:
    """Return the numbers of a comma-separated text; any other value as it is.

    The command line gives vectors as text.
    """
    if not isinstance(values, str):
        return values
    try:
        return [float(value) for value in values.split(",")]
    except ValueError:
        return values


def split_text(names: object) -> object:
    """Return the names of a comma-separated text; any other value as it is."""
    return [name.strip() for name in names.split(",")] if isinstance(names, str) else names


def _check_path(path: Path) -> Path:
    """Return a path; raise ValueError if it contains a null character."""
    if "\0" in str(path):
        raise ValueError
    return path


def _from_folder(path: object) -> object:
    """Return a path of a scene file joined to the folder of that file; another one as it is."""
    return folder_of(path) / path if isinstance(path, FileText) else path


#: The path of a file, relative to the scene file.
FilePath = Annotated[Path, AfterValidator(_check_path), BeforeValidator(_from_folder)]
CsvFile = Annotated[FilePath, Expect("the path of a CSV file")]
#: The file of a closed surface.
SurfaceFile = Annotated[FilePath, Expect("the path of an STL or OBJ file")]
Text = Annotated[str, Field(min_length=1), Expect("a name")]
Flag = Annotated[bool, Field(strict=True), Expect("true or false")]
FlagOrCoarser = Annotated[StrictBool | Literal["coarser"], Expect("true, false or 'coarser'")]
Number = Annotated[Bounded, Expect("a finite number")]
Positive = Annotated[BoundedPositive, Expect("a number > 0")]
NonNegative = Annotated[Bounded, Field(ge=0), Expect("a number >= 0")]
Cells = Annotated[int, Whole(1, MAX_CELLS)]
Steps = Annotated[int, Whole(1, MAX_STEPS)]
Count = Annotated[int, Whole(1, INT32_MAX)]
Seed = Annotated[int, Whole(0, INT64_MAX)]
_VECTOR = "three finite numbers, [x, y, z]"
Vector = Annotated[
    tuple[Bounded, Bounded, Bounded], Expect(_VECTOR), BeforeValidator(split_numbers)
]
#: A number and a vector of a load that a program may give as UFL expressions.
ScalarValue = Annotated[Bounded, ExpectExpression("a finite number")]
VectorValue = Annotated[
    tuple[Bounded, Bounded, Bounded],
    ExpectExpression(_VECTOR, (1,)),
    BeforeValidator(split_numbers),
]
Matrix = Annotated[tuple[Vector, Vector, Vector], Expect("a matrix, three rows of three numbers")]
Range = Annotated[tuple[Bounded, Bounded], Expect("two finite numbers")]
_Name = Annotated[str, Field(min_length=1)]
_Number = Annotated[int, Field(strict=True, ge=1, le=INT32_MAX)]
_GROUP = f"the name of a physical group, or its number from 1 to {INT32_MAX}"
GroupKey = Annotated[_Name | _Number, Expect(_GROUP)]


def _check_measure(value: object, kinds: tuple[str, ...]) -> object:
    """Return a UFL measure of one of these integral types; raise ValueError for anything else."""
    ufl: Any = sys.modules.get("ufl")
    if ufl is None or not isinstance(value, ufl.Measure) or value.integral_type() not in kinds:
        raise ValueError
    return value


_Measure = Annotated[
    SkipJsonSchema[Any], AfterValidator(partial(_check_measure, kinds=(_CELLS, _FACETS)))
]
_FacetMeasure = Annotated[
    SkipJsonSchema[Any], AfterValidator(partial(_check_measure, kinds=(_FACETS,)))
]
#: The description of keys of the type `Surface`.
SURFACE = "Physical group of surfaces, by name or number; in a program a measure ds(...)."
#: A surface: a physical group of a scene, or a measure of a program.
Surface = Annotated[
    _Name | _Number | _FacetMeasure, Expect(f"{_GROUP}; in a program a measure ds(...)")
]
#: A part of a body: a physical group of a scene, or a measure of a program.
Part = Annotated[
    _Name | _Number | _Measure, Expect(f"{_GROUP}; in a program a measure dx(...) or ds(...)")
]


def surface_name(surface: Any) -> str:
    """Return the name for results and messages: of a physical group, or "ds(1)" of a measure."""
    if not hasattr(surface, "subdomain_id"):
        return str(surface)
    symbol = "dx" if surface.integral_type() == _CELLS else "ds"
    return f"{symbol}({surface.subdomain_id()})"


Groups = Annotated[
    list[GroupKey],
    Expect("a list of names or numbers of physical groups"),
    BeforeValidator(split_text),
]
Axis = Literal["x", "y", "z"]
Components = Annotated[
    tuple[Axis, ...],
    Field(min_length=1, max_length=3),
    Expect("a list of 'x', 'y', 'z'"),
    BeforeValidator(split_text),
]
PoissonRatios = Annotated[
    list[Annotated[Finite, Field(gt=-1, lt=0.5)]],
    Expect("a list of Poisson's ratios in (-1, 0.5)"),
]


def _check_float(value: object) -> object:
    """Return a float; raise ValueError for an int, which a strict float of pydantic accepts."""
    if not isinstance(value, float):
        raise ValueError
    return value


def _check_text(value: object) -> object:
    """Return a value; reject texts with a number outside 32 bits, which PETSc would truncate."""
    if isinstance(value, str):
        for item in value.split(","):
            # int() itself refuses more than 4300 digits.
            digits = item.strip().lstrip("+-").lstrip("0")
            if digits.isdecimal() and (len(digits) > _DIGITS or int(digits) > INT32_MAX):
                raise ValueError
    return value


def _remove_dashes(options: dict[str, object]) -> dict[str, object]:
    """Return PETSc options without leading dashes; raise BadInput for one without a name."""
    for key in options:
        if not key.strip("-").strip():
            raise bad_value("petsc", options, "the name of a PETSc option for each value")
    return {key.lstrip("-"): value for key, value in options.items()}


#: A value of a PETSc option, from a scene or, as text, from the command line.
Option = (
    Annotated[bool, Field(strict=True)]
    | Annotated[int, Field(strict=True, ge=-INT32_MAX, le=INT32_MAX)]
    | Annotated[Finite, BeforeValidator(_check_float)]
    | Annotated[str, BeforeValidator(_check_text)]
    | None
)

#: PETSc options by name, without the leading dash.
Options = Annotated[
    dict[str, Option],
    Expect("a table of numbers (whole ones of 32 bits), texts, true and false"),
    AfterValidator(_remove_dashes),
]
