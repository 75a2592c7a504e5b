"""What a scene may say: the same tables, with the same rules, for Python scenes and TOML files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from fem_snh.choices import (
    DEFAULT_EIGENSOLVER,
    DEFAULT_HESSIAN,
    DEFAULT_PREDICTOR,
    EIGENSOLVERS,
    GLOBALIZATIONS,
    HESSIANS,
    PREDICTORS,
    replace_alias,
)
from fem_snh.errors import BadInput, choose, note_rename
from fem_snh.fem.elements import ELEMENTS
from fem_snh.scenes._conditions import Hold, Move, Rotate, Start, Traction
from fem_snh.scenes._material import MaterialChoice
from fem_snh.scenes._types import Count, GroupKey, Text, Vector
from fem_snh.scenes._validation import Expect, Finite, Table

__all__ = [
    "Geometry", "Hold", "MaterialChoice", "Modes", "Move", "Probe", "Rotate", "Scene",
    "Start", "Traction",
]  # fmt: skip

Scalar = Annotated[bool, Field(strict=True)] | Annotated[int, Field(strict=True)] | Finite | str
Softer = Annotated[
    list[Annotated[Finite, Field(gt=-1, lt=0.5)]],
    Expect("a list of Poisson's ratios in (-1, 0.5)"),
]


#: Old names of a scene's keys, and their new ones.
RENAMED = {"soften": "nu_continuation"}


class Geometry(Table):
    """A built-in geometry: a gmsh source under meshes/ and its parameters besides ``cells``."""

    source: Text
    parameters: Annotated[
        dict[str, Annotated[int, Field(strict=True)] | Finite], Expect("a table of numbers")
    ] = {}


class Probe(Table):
    """A point of the body, in reference coordinates, whose displacement each step reports."""

    name: Text
    point: Vector


class Modes(Table):
    """The ``count`` lowest eigenfrequencies at the end, for a mass density [kg/m^3]."""

    count: Count = 10
    density: Annotated[Finite, Field(gt=0), Expect("a number > 0 (mass density)")] = 1000.0


Mesh = Annotated[
    Annotated[Geometry, Tag("built-in")]
    | Annotated[Path, Expect("a gmsh file or a built-in geometry"), Tag("file")],
    Discriminator(lambda mesh: "built-in" if isinstance(mesh, dict | Geometry) else "file"),
]


class Scene(Table):
    """One quasi-static experiment: everything `fem_snh.run` needs to know.

    The load goes from 0 to 1 in ``steps`` equal steps; ``load_range`` is what plots call its ends.
    ``cells`` is the resolution of a built-in geometry, None for a mesh file. ``reactions`` are
    groups whose total force each step reports, ``probe`` points whose displacement; ``modes`` asks
    for eigenfrequencies at the end. ``hessian`` and ``globalization`` are Newton's method's
    (`fem_snh.solver.create`). ``start`` is where the first step begins: there is nothing to predict
    it from, so it needs ``predictor`` none. ``nu_continuation`` are Poisson's ratios with which
    each step is solved before it is with the material's own. ``quadrature`` is a polynomial degree,
    None the element's own; ``eigensolver`` is of the Hessian's 3x3 scaling block. ``petsc`` holds
    PETSc options without the leading dash, to go under the solver's prefix; a flag's value is None.
    """

    name: Text
    mesh: Mesh
    cells: Count | None = None
    element: Annotated[str, Expect("one of " + ", ".join(ELEMENTS))]
    quadrature: Count | None = None
    hessian: str = DEFAULT_HESSIAN
    globalization: str | None = None
    eigensolver: str = DEFAULT_EIGENSOLVER
    steps: Count = 1
    material: MaterialChoice
    hold: list[Hold] = []
    move: list[Move] = []
    traction: list[Traction] = []
    start: Start | None = None
    nu_continuation: Softer = []
    reactions: Annotated[
        list[GroupKey], Expect("a list of names or numbers of physical groups")
    ] = []
    probe: list[Probe] = []
    modes: Modes | None = None
    predictor: str = DEFAULT_PREDICTOR
    petsc: Annotated[
        dict[str, Scalar | None], Expect("a table of numbers, texts, true and false")
    ] = {}
    load_name: Text = "load"
    load_range: Annotated[tuple[Finite, Finite], Expect("two finite numbers")] = (0.0, 1.0)

    @model_validator(mode="before")
    @classmethod
    def _renamed(cls, data: Any) -> Any:
        """Accept the old names of keys and values, with a note."""
        if not isinstance(data, dict):
            return data
        for key in [key for key in data if key in RENAMED]:
            note_rename(key, RENAMED[key])
        data = {RENAMED.get(key, key): value for key, value in data.items()}
        if "hessian" in data:
            choices = replace_alias(data["hessian"], data.get("globalization"))
            data |= dict(zip(("hessian", "globalization"), choices, strict=True))
        return data

    @field_validator("element", "hessian", "globalization", "eigensolver", "predictor")
    @classmethod
    def _known(cls, name: str | None, info: ValidationInfo) -> str | None:
        if name is None:
            return None
        known = {
            "element": ELEMENTS,
            "hessian": HESSIANS,
            "globalization": GLOBALIZATIONS,
            "eigensolver": EIGENSOLVERS,
            "predictor": PREDICTORS,
        }
        key = str(info.field_name)
        return choose(key, name, known[key])

    @field_validator("probe")
    @classmethod
    def _named_once(cls, probes: list[Probe]) -> list[Probe]:
        names = [probe.name for probe in probes]
        for name in names:
            if names.count(name) > 1:
                raise BadInput(f"two probes are called '{name}': give each a name of its own")
        return probes

    @field_validator("petsc")
    @classmethod
    def _no_dash(cls, options: dict[str, Any]) -> dict[str, Any]:
        return {key.lstrip("-"): value for key, value in options.items()}

    @model_validator(mode="after")
    def _consistent(self) -> Scene:
        if isinstance(self.mesh, Geometry) and self.cells is None:
            raise BadInput("missing key 'cells': expected a whole number, 1 or more")
        if isinstance(self.mesh, Path) and self.cells is not None:
            raise BadInput(
                f"cells = {self.cells}: only a built-in geometry has it; the cells come from "
                f"{self.mesh.name}"
            )
        if self.start is not None and self.predictor != "none":
            begins = "a run that begins at a 'start' has none: expected predictor = 'none'"
            raise BadInput(f"predictor = '{self.predictor}': {begins}")
        taken = [(str(h.group), set(h.components), "held") for h in self.hold]
        for move in self.move:
            for group, components, how in taken:
                both = components & set(move.components)
                if group == str(move.group) and both:
                    raise BadInput(
                        f"group '{group}' is both {how} and moved in {', '.join(sorted(both))}: "
                        "take it out of one, or give each its own 'components'"
                    )
            taken.append((str(move.group), set(move.components), "moved"))
        return self
