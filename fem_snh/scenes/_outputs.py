"""Tables of a scene that state its geometry and its additional results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.choices import LATTICE_WEIGHTINGS
from fem_snh.errors import bad_value, choose, suggestion_for
from fem_snh.records.output_fields import LOCATIONS, NAMED
from fem_snh.records.units import Units
from fem_snh.tables.shapes import ShapeChoice
from fem_snh.tables.types import (
    Count,
    FilePath,
    Flag,
    GroupKey,
    Positive,
    SurfaceFile,
    Text,
    Vector,
    split_text,
)
from fem_snh.tables.validation import Bounded, Expect, OneOf, Table, Whole
from fem_snh.terms.feature import Feature, grouped
from fem_snh.terms.rigid import RESULTS

if TYPE_CHECKING:
    from fem_snh.scenes.schema import Scene


# --- the geometry --------------------------------------------------------------------------------


class Geometry(Table):
    """A built-in geometry: a gmsh source of the folder meshes/ and the values of its parameters."""

    source: Text = Field(description="Name of the gmsh source, e.g. cube, cylinder, block, cook.")
    parameters: Annotated[dict[str, Bounded], Expect("a table of numbers")] = Field(
        default={},
        description="Values of its parameters, except for cells, which the scene has [length].",
    )


#: Bounds of the cubes along a cell's edge: 1 cannot separate two parts of the body in a cell, and
#: more than 16 need gigabytes.
_SAMPLES = (2, 16)


#: A file of a closed surface, or the table of a shape; the tags are removed from messages.
Body = Annotated[
    Annotated[ShapeChoice, Tag("<shape>")] | Annotated[SurfaceFile, Tag("<surface>")],
    Discriminator(lambda body: "<shape>" if isinstance(body, dict | ShapeChoice) else "<surface>"),
]


Weighting = Annotated[str, OneOf(LATTICE_WEIGHTINGS)]


class Lattice(Table):
    """A body in a lattice of equal cubes, which its surface cuts."""

    lattice: Body = Field(
        description="The body: an STL or OBJ file of a closed surface, relative to the scene file; "
        "or a table as `shape` is."
    )
    cell: Positive = Field(description="Edge of a cell [length].")
    weighting: Weighting = Field(
        default=LATTICE_WEIGHTINGS[0],
        description="How energy, mass and weight of a cell count: by the fraction of it that the "
        "body fills, or in full.",
    )
    samples: Annotated[int, Whole(*_SAMPLES)] = Field(
        default=4,
        description="Fractions and parts are sampled on this number of cubes along a cell's edge.",
    )
    skin: Annotated[int, Whole(1, 8)] = Field(
        default=2,
        description="The surface of a shape is triangulated on this number of cubes along a "
        "cell's edge; that of a file is the file's.",
    )

    @model_validator(mode="after")
    def _check_skin(self) -> Lattice:
        if isinstance(self.lattice, Path) and self.skin != type(self).model_fields["skin"].default:
            accepted = f"no value, as the surface is that of {self.lattice}"
            raise bad_value("skin", self.skin, accepted)
        return self


class Tetrahedra(Table):
    """A body that tetrahedra fill."""

    surface: Body = Field(
        description="The body: an STL or OBJ file of a closed surface, relative to the scene file; "
        "or a table as `shape` is."
    )
    size: Positive = Field(description="Edge of a tetrahedron [length].")


def _kind(mesh: Any) -> str:
    """Return the tag of a scene's mesh."""
    if isinstance(mesh, Lattice) or (isinstance(mesh, dict) and "lattice" in mesh):
        return "<lattice>"
    if isinstance(mesh, Tetrahedra) or (isinstance(mesh, dict) and "surface" in mesh):
        return "<tetrahedra>"
    return "<built-in>" if isinstance(mesh, dict | Geometry) else "<file>"


#: A file, a built-in geometry, a lattice or tetrahedra; the tags are removed from messages.
Mesh = Annotated[
    Annotated[Geometry, Tag("<built-in>")]
    | Annotated[Lattice, Tag("<lattice>")]
    | Annotated[Tetrahedra, Tag("<tetrahedra>")]
    | Annotated[
        FilePath,
        Expect("a gmsh file, an XDMF file or an XAO file, or a built-in geometry"),
        Tag("<file>"),
    ],
    Discriminator(_kind),
]


# --- results -------------------------------------------------------------------------------------


class Probe(Table):
    """A point of the body whose displacement is reported after each step."""

    name: Text = Field(description="Name of the point in the results.")
    point: Vector = Field(description="Reference coordinates [length].")
    radius: Positive | None = Field(
        default=None,
        description="Of the goal NAME.stress, the mean of von Mises' stress around the point: the "
        "distance at which the weight is 0.14 of that at the point [length].",
    )


class Reaction(Table):
    """A physical group whose reaction is reported after each step."""

    group: GroupKey = Field(
        description="Physical group, by name or number. Its reaction is the force of its own "
        "conditions; what several constrain, as on a common edge, counts for the last, which sets "
        "the value; of a group without conditions, it is that of all others at its nodes, or zero."
    )
    about: Vector | None = Field(
        default=None,
        description="Point of the moment, which is reported too [length]; without it the force "
        "alone.",
    )


class _Named(BeforeValidator):
    """A validator of a list of tables, in which a text or a number gives the value of one key."""

    def __init__(self, list_key: str, key: str, accepted: str) -> None:
        def tables(values: object) -> object:
            values = split_text(values)
            if not isinstance(values, list | tuple) or not all(
                value and isinstance(value, str | int | dict | Table) for value in values
            ):
                raise bad_value(list_key, values, accepted)
            return [{key: value} if isinstance(value, str | int) else value for value in values]

        super().__init__(tables)


#: Groups by name or number, or as tables with the point of the moment.
Reactions = Annotated[
    list[Reaction],
    _Named(
        "reactions",
        "group",
        "a list of names or numbers of physical groups, or of { group = ..., about = [x, y, z] }",
    ),
]

#: Default density of materials in modes [kg/m^3]: the density of water.
DEFAULT_DENSITY = 1000.0


class Modes(Table):
    """Eigenfrequencies of the body, computed at the end of the run (needs SLEPc)."""

    count: Count = Field(default=10, description="Number of modes, from the lowest.")
    density: Positive | None = Field(
        default=None,
        description="Mass per reference volume [kg/m^3] of materials without a density; "
        f"default: {DEFAULT_DENSITY:g}.",
    )


def _check_fields(names: list[str]) -> list[str]:
    """Return the names without repetition; raise BadInput for an unknown one."""
    return list(dict.fromkeys(choose("fields", name, NAMED) for name in names))


def _check_units(text: str) -> str:
    """Return the text; raise BadInput if it does not name units."""
    Units.read(text)
    return text


#: Names of output fields.
OutputFields = Annotated[
    list[str],
    Expect("a list of names of fields"),
    BeforeValidator(split_text),
    AfterValidator(_check_fields),
]
#: Units that labels name.
UnitNames = Annotated[
    str,
    Expect('units of length, force and stress, "mm, N, MPa"'),
    AfterValidator(_check_units),
]
#: Where output fields are written.
Location = Annotated[str, OneOf(LOCATIONS)]


# --- goals of error estimates --------------------------------------------------------------------

_AXES = "xyz"
#: Quantities of a physical group, and whether they have components.
_OF_GROUPS = {"force": True, "moment": True, "mean": True, "volume": False, "stress": False}
#: Quantities of the whole body.
_OF_BODY = ("energy", "volume", "stress")
_ACCEPTED = (
    "'energy', 'volume', 'stress', a probe with a component, 'corner.y', of a physical group "
    "'top.force.z', 'top.moment.z' (reaction), 'top.mean.z' (mean displacement), 'core.volume', "
    "'core.stress' (mean of von Mises' stress), of a probe with a radius 'corner.stress', "
    "of an obstacle or a contact 'plate.force.z', of a cavity 'inner.pressure', of a rigid part "
    "'lid.displacement.z', 'lid.rotation.z', 'lid.force.z', 'lid.moment.z'; without the component: "
    "all of them"
)


class GoalChoice(Table):
    """A goal, and the load, or time, at which it is evaluated."""

    name: Text = Field(description="Its name.")
    at: Annotated[
        Annotated[Bounded, Field(ge=0)] | Literal["largest"] | None,
        Expect("'largest', or the load of a step, from 0 to 1; in time, the time of one [s]"),
    ] = Field(
        default=None,
        description="The load of a step, or its time [s], or 'largest': where it differs most from "
        "its value at the start. Default: the end, and 'largest' where loads or motions return.",
    )


_GOALS = "a list of goals, e.g. 'corner.y', 'top.force.z', 'volume', 'energy'"


class GoalName(NamedTuple):
    """A goal of a scene.

    Attributes
    ----------
    kind : str
        "energy", "volume", "stress", "force", "moment", "mean"; "point" and "stress_at" of a probe;
        "term", a result of a feature; "rigid", a result of a rigid part.
    name : str
        The probe, the physical group or the result; empty for the whole body.
    components : tuple of int
        The components of a vector.
    """

    kind: str
    name: str = ""
    components: tuple[int, ...] = ()

    @property
    def is_of_group(self) -> bool:
        """Whether the goal is a quantity of a physical group."""
        return self.kind in _OF_GROUPS and bool(self.name)


def _read_share(value: Any) -> Any:
    """Return 0.01 for "1%", "1 %" or "0.01"; other values as they are."""
    if not isinstance(value, str):
        return value
    number, percent, rest = value.strip().partition("%")
    try:
        return value if rest else float(number) / (100 if percent else 1)
    except ValueError:
        return value


class Accuracy(Table):
    """Goals whose errors are estimated, and the accuracy that they are to have."""

    needs = dict.fromkeys(("max_time", "max_dofs", "keep_element", "path"), ("within",))
    goals: Annotated[list[GoalChoice], _Named("goals", "name", _GOALS)] = Field(
        default=[],
        description="Names, or { name = ..., at = ... }: probes and their components, corner.y; "
        "reaction forces and moments and mean displacements of groups, top.force.z, top.moment.z "
        "and top.mean.z; forces of obstacles and contacts, plate.force.z; pressures of cavities, "
        "inner.pressure; motions of rigid parts and what holds them, lid.displacement.z, "
        "lid.rotation.z, lid.force.z and lid.moment.z; means of von Mises' stress, stress and "
        "core.stress; volume ratios, volume and core.volume; energy. Default: probes, "
        "reactions, what is unknown of rigid parts, of a static scene those forces and "
        "pressures, volumes and energy.",
    )
    within: (
        Annotated[
            Bounded,
            Field(gt=0, lt=1),
            Expect("per cent or a fraction, more than 0 and less than 1, e.g. '1%' or 0.01"),
            BeforeValidator(_read_share),
        ]
        | None
    ) = Field(
        default=None,
        description="Relative error that every goal may have: the scene is solved on finer and "
        "finer meshes until it has.",
    )
    path: Flag = Field(
        default=False,
        description="Whether the load steps are followed on the last mesh too: steps.csv then has "
        "the whole curve.",
    )
    max_time: Positive | None = Field(
        default=None,
        description="No further level is begun that is expected to end later [s]; one that has not "
        "ended after twice as long is given up.",
    )
    max_memory: Positive | None = Field(
        default=None,
        description="Nor one whose estimate needs more memory [MB]; without `within` there is then "
        "no estimate.",
    )
    max_dofs: Positive | None = Field(default=None, description="Nor one with more unknowns.")
    keep_element: Flag = Field(
        default=False,
        description="Whether every level has the degree and the kind of cell of the scene's "
        "element; otherwise others replace it where they reach the accuracy sooner.",
    )

    @property
    def names(self) -> list[str]:
        """The names of the goals."""
        return [goal.name for goal in self.goals]


def term_goals(features: Sequence[Feature]) -> list[str]:
    """Return the names of the goals that are results of features."""
    return [name for kind, some in grouped(features) for name in kind.goals(some)]


def read_goal(text: str, scene: Scene) -> GoalName:
    """Return the goal that a text such as "corner.y" or "top.force.z" names.

    Raises
    ------
    BadInput
        For a text that is no goal of the scene.
    """
    results, parts = term_goals(scene.features), scene.rigid
    vectors = {probe.name: "point" for probe in scene.probe}
    vectors |= {name: "term" for name in results if name.endswith(".force")}
    vectors |= {f"{part.label}.{result}": "rigid" for part in parts for result in RESULTS}
    scalars = {name: GoalName("term", name) for name in results if name not in vectors}
    scalars |= {f"{p.name}.stress": GoalName("stress_at", p.name) for p in scene.probe if p.radius}
    scalars |= {name: GoalName(name) for name in _OF_BODY}
    if text in scalars:
        return scalars[text]
    rest, _, last = text.rpartition(".")
    has_component = bool(rest) and last in tuple(_AXES)
    vector = rest if has_component else text
    group, _, quantity = vector.rpartition(".")
    if vector in vectors:
        kind, name = vectors[vector], vector
    elif group and quantity in _OF_GROUPS and (_OF_GROUPS[quantity] or not has_component):
        kind, name = quantity, group
    else:
        known = [f"{name}.{last}" for name in vectors] if has_component else [*vectors, *scalars]
        raise bad_value("accuracy.goals", text, _ACCEPTED + suggestion_for(text, known))
    if not _OF_GROUPS.get(kind, True):
        return GoalName(kind, name)
    kinematics = kinematics_of(scene.kinematics)
    axes = kinematics.moment_axes if quantity in ("moment", "rotation") else kinematics.axes
    if not axes or (has_component and last not in axes):
        accepted = f"a component {' or '.join(axes)}" if axes else "another goal"
        raise bad_value(
            "accuracy.goals", text, f"{accepted}, with kinematics = '{kinematics.name}'"
        )
    components = (last,) if has_component else axes
    return GoalName(kind, name, tuple(map(_AXES.index, components)))
