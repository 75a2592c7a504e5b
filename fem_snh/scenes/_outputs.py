"""Tables of a scene that state its geometry and its additional results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.choices import ESTIMATES, LIFTED_ELEMENT
from fem_snh.errors import bad_value, choose, nearest
from fem_snh.records.output_fields import LOCATIONS, NAMED
from fem_snh.scenes._lattice import Lattice, Tetrahedra
from fem_snh.tables.types import (
    Count,
    FilePath,
    GroupKey,
    Positive,
    Text,
    Vector,
    split_text,
)
from fem_snh.tables.validation import Bounded, Expect, OneOf, Table, check_distinct
from fem_snh.terms.feature import Feature, grouped
from fem_snh.terms.rigid import RESULTS, Rigid

if TYPE_CHECKING:
    from fem_snh.scenes.schema import Scene


class Geometry(Table):
    """A built-in geometry: a gmsh source of the folder meshes/ and the values of its parameters."""

    source: Text = Field(description="Name of the gmsh source, e.g. cube, cylinder, block, cook.")
    parameters: Annotated[dict[str, Bounded], Expect("a table of numbers")] = Field(
        default={},
        description="Values of its parameters, except for cells, which the scene has [length].",
    )


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


def _as_tables(groups: object) -> object:
    """Return a table for each name or number of a list, or of a comma list."""
    groups = split_text(groups)
    if not isinstance(groups, list | tuple) or not all(
        g and isinstance(g, str | int | dict | Reaction) for g in groups
    ):
        raise bad_value("reactions", groups, _REACTIONS)
    return [{"group": g} if isinstance(g, str | int) else g for g in groups]


_REACTIONS = (
    "a list of names or numbers of physical groups, or of { group = ..., about = [x, y, z] }"
)
#: Groups by name or number, or with the point of their moment.
Reactions = Annotated[list[Reaction], BeforeValidator(_as_tables)]


def _check_names(probes: list[Probe]) -> list[Probe]:
    """Raise BadInput if two probes have one name."""
    check_distinct("name", [probe.name for probe in probes], "probe")
    return probes


#: Probes with different names.
Probes = Annotated[list[Probe], AfterValidator(_check_names)]

#: Density of materials in modes [kg/m^3]: that of water.
DEFAULT_DENSITY = 1000.0


class Modes(Table):
    """Eigenfrequencies of the body, computed at the end of the run (needs SLEPc)."""

    count: Count = Field(default=10, description="Number of modes, from the lowest.")
    density: Positive | None = Field(
        default=None,
        description="Mass per reference volume [kg/m^3] of materials without a density; "
        f"default: {DEFAULT_DENSITY:g}.",
    )

    @property
    def goals(self) -> list[str]:
        """The names of the frequencies as goals."""
        return [f"frequency.{number}" for number in range(1, self.count + 1)]


def _check_fields(names: list[str]) -> list[str]:
    """Return the names without repetition; raise BadInput for an unknown one."""
    return list(dict.fromkeys(choose("fields", name, NAMED) for name in names))


def _check_units(text: str) -> str:
    from fem_snh.records.units import Units

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


def _kind(mesh: Any) -> str:
    """Return the tag of a scene's mesh."""
    if isinstance(mesh, Lattice) or (isinstance(mesh, dict) and "lattice" in mesh):
        return "in a lattice"
    if isinstance(mesh, Tetrahedra) or (isinstance(mesh, dict) and "surface" in mesh):
        return "of tetrahedra"
    return "built-in" if isinstance(mesh, dict | Geometry) else "file"


#: A gmsh or XDMF file, a built-in geometry or a lattice; the tags are removed from messages.
Mesh = Annotated[
    Annotated[Geometry, Tag("built-in")]
    | Annotated[Lattice, Tag("in a lattice")]
    | Annotated[Tetrahedra, Tag("of tetrahedra")]
    | Annotated[
        FilePath,
        Expect("a gmsh file, an XDMF file or an XAO file, or a built-in geometry"),
        Tag("file"),
    ],
    Discriminator(_kind),
]


_AXES = "xyz"
#: Quantities of a physical group, with whether they have components.
_OF_GROUPS = {"force": True, "moment": True, "mean": True, "volume": False, "stress": False}
#: Those of the whole body.
_OF_BODY = ("energy", "volume", "stress")
_ACCEPTED = (
    "'energy', 'volume', 'stress', a probe with a component, 'corner.y', of a physical group "
    "'top.force.z', 'top.moment.z' (reaction), 'top.mean.z' (mean displacement), 'core.volume', "
    "'core.stress' (mean of von Mises' stress), of a probe with a radius 'corner.stress', "
    "of an obstacle or a contact 'plate.force.z', of a cavity 'inner.pressure', of a rigid part "
    "'lid.displacement.z', 'lid.rotation.z', 'lid.force.z', 'lid.moment.z'; without the component: "
    "all of them; with [modes] 'frequency.1'"
)


#: The load of a goal at which it differs most from its value at the start.
LARGEST = "largest"


class GoalChoice(Table):
    """A goal, and the load at which it counts."""

    name: Text = Field(description="Its name.")
    at: Annotated[
        Annotated[Bounded, Field(ge=0, le=1)] | Literal["largest"] | None,
        Expect("'largest', or the load of a step, from 0 to 1"),
    ] = Field(
        default=None,
        description="The load of a step, or 'largest': that at which it differs most from its "
        "value at the start. Default: the end, and 'largest' where loads or motions return.",
    )


def _as_goals(goals: object) -> object:
    """Return the tables of goals that are given by their names."""
    goals = split_text(goals)
    if not isinstance(goals, list | tuple) or not all(
        g and isinstance(g, str | dict | GoalChoice) for g in goals
    ):
        raise bad_value("accuracy.goals", goals, _GOALS)
    return [{"name": goal} if isinstance(goal, str) else goal for goal in goals]


_GOALS = "a list of goals, e.g. 'corner.y', 'top.force.z', 'volume', 'energy'"


class GoalName(NamedTuple):
    """A goal of a scene.

    Attributes
    ----------
    kind : str
        What it is: "energy", "volume", "stress", "force", "moment", "mean", "point", "stress_at" a
        probe, "term", the result of a feature, "rigid", that of a rigid part, "frequency".
    name : str
        The probe, the physical group, the result or the number of the frequency; empty for the
        whole body.
    components : tuple of int
        The components of a vector.
    """

    kind: str
    name: str = ""
    components: tuple[int, ...] = ()

    @property
    def is_of_group(self) -> bool:
        """Whether it names a physical group."""
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
    """The goals of the error estimate, which a scene with this table has, and their accuracy."""

    needs = dict.fromkeys(("max_time", "max_dofs", "keep_element", "path"), ("within",))
    goals: Annotated[
        list[GoalChoice],
        BeforeValidator(_as_goals),
    ] = Field(
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
    estimate: Annotated[str, OneOf(ESTIMATES)] = Field(
        default=LIFTED_ELEMENT,
        description="What the errors are found from: a solution in the element of the next degree, "
        "or those on meshes with half and a quarter of the cells along an edge, which take a "
        "third of the time and no more memory than the run, but show the errors less well.",
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
    path: Annotated[bool, Expect("true or false")] = Field(
        default=False,
        description="Whether the load steps are followed on the last mesh too: steps.csv then has "
        "the whole curve.",
    )
    max_time: Positive | None = Field(
        default=None, description="No further level is begun that ends later [s]."
    )
    max_memory: Positive | None = Field(
        default=None,
        description="Nor one whose estimate needs more memory [MB]; without `within` the estimate "
        "is then that of coarser meshes; in time and with friction there is none.",
    )
    max_dofs: Positive | None = Field(default=None, description="Nor one with more unknowns.")
    keep_element: bool = Field(
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
    """Return the goal of this name.

    Raises
    ------
    BadInput
        For a text that is no goal of the scene.
    """
    kinematics = kinematics_of(scene.kinematics)
    if text in _OF_BODY:
        return GoalName(text)
    if scene.modes and text in (known := scene.modes.goals):
        return GoalName("frequency", str(1 + known.index(text)))
    results = term_goals(scene.features)
    if text in results and not text.endswith(".force"):
        return GoalName("term", text)
    rest, _, last = text.rpartition(".")
    has_component = bool(rest) and last in tuple(_AXES)
    vector = rest if has_component else text
    names = [probe.name for probe in scene.probe]
    group, _, kind = vector.rpartition(".")
    parts = [part.label for part in scene.features if isinstance(part, Rigid)]
    rigid = [f"{part}.{result}" for part in parts for result in RESULTS]
    about_axes = kind in ("moment", "rotation")
    if vector in rigid:
        group, kind = vector, "rigid"
    elif vector in results and vector.endswith(".force"):
        group, kind = vector, "term"
    elif vector in names:
        group, kind = vector, "point"
    elif not group or kind not in _OF_GROUPS or (has_component and not _OF_GROUPS[kind]):
        vectors = [*names, *(name for name in results if name.endswith(".force")), *rigid]
        known = [f"{name}.{last}" for name in vectors] if has_component else [*vectors, *results]
        known += scene.modes.goals if scene.modes else []
        raise bad_value("accuracy.goals", text, _ACCEPTED + nearest(text, known))
    elif not _OF_GROUPS[kind]:
        probed = [probe.name for probe in scene.probe if probe.radius is not None]
        return GoalName("stress_at" if kind == "stress" and group in probed else kind, group)
    axes = kinematics.moment_axes if about_axes else kinematics.axes
    if not axes or (has_component and last not in axes):
        accepted = f"a component {' or '.join(axes)}" if axes else "another goal"
        raise bad_value(
            "accuracy.goals", text, f"{accepted}, with kinematics = '{kinematics.name}'"
        )
    components = (last,) if has_component else axes
    return GoalName(kind, group, tuple(map(_AXES.index, components)))
