"""The schema of a scene: the same tables and rules for Python scenes and for TOML files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator, model_validator

from fem_snh.choices import (
    ASSEMBLIES,
    DEFAULT_ASSEMBLY,
    DEFAULT_EIGENSOLVER,
    DEFAULT_HESSIAN,
    DEFAULT_PREDICTOR,
    EIGENSOLVERS,
    GLOBALIZATIONS,
    HESSIANS,
    PREDICTORS,
    replace_alias,
)
from fem_snh.errors import BadInput, bad_value, choose, note_rename
from fem_snh.fem.elements import ELEMENTS
from fem_snh.scenes._conditions import Hold, Motion, Move, Rotate, Start, check_constraints, motions
from fem_snh.scenes._loads import Cavity, Gravity, Pressure, Spring, Traction, check_other_tables
from fem_snh.scenes._material import MaterialChoice, Materials, common_ratio
from fem_snh.scenes._outputs import Geometry, Location, Mesh, Modes, OutputFields, Probe
from fem_snh.scenes._tables import Amplitude, amplitude, check_tables
from fem_snh.scenes._types import (
    MAX_CELLS,
    Cells,
    Degree,
    Groups,
    Option,
    PoissonRatios,
    Range,
    Steps,
    Text,
)
from fem_snh.scenes._validation import Expect, Table

__all__ = [
    "RENAMED", "Amplitude", "Cavity", "Geometry", "Gravity", "Hold", "MaterialChoice", "Modes",
    "Motion", "Move", "Pressure", "Probe", "Rotate", "Scene", "Spring", "Start", "Traction",
]  # fmt: skip

#: Old names of a scene's keys, and their new ones.
RENAMED = {"soften": "nu_continuation"}

#: The values of keys that accept one of several words.
WORDS = {
    "element": tuple(ELEMENTS),
    "hessian": HESSIANS,
    "globalization": GLOBALIZATIONS,
    "eigensolver": EIGENSOLVERS,
    "assembly": ASSEMBLIES,
    "predictor": PREDICTORS,
}


class Scene(Table):
    """A quasi-static experiment: all that `fem_snh.run` needs.

    The load goes from 0 to 1 in ``steps`` equal increments.
    """

    name: Text = Field(description="Name of the scene; default: the file's name.")
    mesh: Mesh = Field(
        description="Path of a gmsh file, relative to the scene file; or a built-in geometry."
    )
    cells: Cells | None = Field(
        default=None,
        description="Resolution of a built-in geometry, in cells along an edge; "
        "a mesh file has none.",
    )
    element: Annotated[str, Expect("one of " + ", ".join(ELEMENTS))] = Field(
        description=f"Finite element, one of {', '.join(ELEMENTS)}: P on tetrahedra, Q on "
        "hexahedra; then the degree of the displacement; P0 with mean dilatation; P1 or Q1 with "
        "a continuous pressure (Taylor-Hood)."
    )
    quadrature: Degree | None = Field(
        default=None,
        description="Polynomial degree that the quadrature rule integrates exactly; "
        "default: the element's.",
    )
    hessian: str | None = Field(
        default=None,
        description=f"Hessian of Newton's method, one of {', '.join(HESSIANS)}; "
        f"default: {DEFAULT_HESSIAN}.",
    )
    globalization: str | None = Field(
        default=None,
        description=f"Globalisation of Newton's method, one of {', '.join(GLOBALIZATIONS)}; "
        "default: linesearch if a Hessian is named, and for any problem but a minimisation "
        "problem; else trust_region.",
    )
    eigensolver: str = Field(
        default=DEFAULT_EIGENSOLVER,
        description="Eigensolver of the Hessian's 3x3 scaling block, "
        f"one of {', '.join(EIGENSOLVERS)}.",
    )
    assembly: str = Field(
        default=DEFAULT_ASSEMBLY,
        description="What evaluates the elastic energy and its residual: the program's kernels or "
        "UFL forms compiled by FFCx. The Hessian is always the kernels'.",
    )
    steps: Steps = Field(
        default=1, description="Number of load steps; a step that fails is halved."
    )
    material: Materials = Field(
        description="The material; or several, [[material]], which fill groups of volumes."
    )
    hold: list[Hold] = Field(default=[], description="Groups that do not move.")
    move: list[Move] = Field(default=[], description="Groups that move with the load.")
    traction: list[Traction] = Field(default=[], description="Dead loads on surfaces.")
    gravity: Gravity | None = Field(default=None, description="The weight of the body.")
    pressure: list[Pressure] = Field(default=[], description="Follower loads on surfaces.")
    spring: list[Spring] = Field(default=[], description="Elastic foundations of surfaces.")
    cavity: list[Cavity] = Field(default=[], description="Fluids of prescribed volume.")
    table: list[Amplitude] = Field(default=[], description="Amplitudes of loads and motions.")
    start: Start | None = Field(
        default=None, description="Initial displacement; it needs predictor = 'none'."
    )
    nu_continuation: PoissonRatios = Field(
        default=[],
        description="Continuation in Poisson's ratio: the ratios with which each step is solved "
        "before it is solved with the material's own.",
    )
    reactions: Groups = Field(
        default=[],
        description="Physical groups whose total reaction force is reported after each step.",
    )
    probe: list[Probe] = Field(
        default=[], description="Points whose displacement is reported after each step."
    )
    fields: OutputFields = Field(
        default=[], description="Stresses, strains and forces to write; see the table of fields."
    )
    fields_at: Location = Field(
        default="cells",
        description="Means over cells, or nodes: values of the L2 projection to degree 1.",
    )
    modes: Modes | None = Field(default=None, description="Eigenfrequencies at the end of the run.")
    predictor: str = Field(
        default=DEFAULT_PREDICTOR,
        description=f"Initial guess of a load step, one of {', '.join(PREDICTORS)}: the last "
        "equilibrium, its linear extrapolation in the load, or a linear solve with the tangent.",
    )
    petsc: Annotated[
        dict[str, Option],
        Expect("a table of numbers (whole ones of 32 bits), texts, true and false"),
    ] = Field(
        default={},
        description="PETSc options under the solver's prefix, with or without the leading dash; "
        "the value of a flag is true.",
    )
    load_name: Text = Field(default="load", description="What plots call the load.")
    load_range: Range = Field(
        default=(0.0, 1.0), description="What plots show for the loads 0 and 1."
    )

    @model_validator(mode="before")
    @classmethod
    def _rename(cls, data: Any) -> Any:
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

    @field_validator(*WORDS)
    @classmethod
    def _check_word(cls, word: str | None, info: ValidationInfo) -> str | None:
        key = str(info.field_name)
        return None if word is None else choose(key, word, WORDS[key])

    @field_validator("probe")
    @classmethod
    def _check_probes(cls, probes: list[Probe]) -> list[Probe]:
        names = [probe.name for probe in probes]
        for name in names:
            if names.count(name) > 1:
                raise bad_value("name", name, "a different name for each probe")
        return probes

    @field_validator("petsc")
    @classmethod
    def _remove_dashes(cls, options: dict[str, Any]) -> dict[str, Any]:
        """Remove the leading dash of PETSc options."""
        for key in options:
            if not key.strip("-").strip():
                raise bad_value("petsc", options, "the name of a PETSc option for each value")
        return {key.lstrip("-"): value for key, value in options.items()}

    def amplitudes(
        self, loads: Sequence[Traction | Gravity | Pressure | Cavity | Spring]
    ) -> list[Callable[[float], float]]:
        """Return the amplitude of each load as a function of the load parameter."""
        return [amplitude(self.table, load.table) for load in loads]

    @property
    def materials(self) -> list[MaterialChoice]:
        """The materials: one, or several with their groups."""
        return self.material if isinstance(self.material, list) else [self.material]

    @property
    def nu(self) -> float:
        """Poisson's ratio. Raises BadInput unless all materials have the same."""
        return common_ratio(self.materials)

    @property
    def motions(self) -> list[Motion]:
        """The motions of ``move`` with their amplitudes."""
        return motions(self.move, self.table)

    @model_validator(mode="after")
    def _check_loads(self) -> Scene:
        check_tables(self.table, dict(self))
        if self.cavity:
            check_other_tables(self.element, self.modes)
        return self

    @model_validator(mode="after")
    def _check_mesh(self) -> Scene:
        if isinstance(self.mesh, Geometry) and self.cells is None:
            raise BadInput(f"missing key 'cells': expected a whole number from 1 to {MAX_CELLS}")
        if isinstance(self.mesh, Path) and self.cells is not None:
            raise bad_value("cells", self.cells, f"no value, as {self.mesh.name} has its own cells")
        return self

    @model_validator(mode="after")
    def _check_predictor(self) -> Scene:
        if self.start is not None and self.predictor != "none":
            raise bad_value("predictor", self.predictor, "'none', as the scene has a 'start'")
        return self

    @model_validator(mode="after")
    def _check_constraints(self) -> Scene:
        check_constraints(self.hold, self.move)
        return self
