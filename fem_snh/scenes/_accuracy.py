"""The table ``[accuracy]`` of a scene: the goals whose errors are estimated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NamedTuple

from pydantic import BeforeValidator, Field

from fem_snh.errors import bad_value, nearest
from fem_snh.scenes._outputs import Probe
from fem_snh.tables.types import Text, split_text
from fem_snh.tables.validation import Expect, Table

_AXES = "xyz"
#: Quantities of a physical group, with whether they have components.
_OF_GROUPS = {"force": True, "mean": True, "volume": False}
_ACCEPTED = (
    "'energy', 'volume', a probe with a component, 'corner.y', or of a physical group "
    "'top.force.z' (reaction), 'top.mean.z' (mean displacement), 'core.volume'; without the "
    "component: all three"
)


class GoalName(NamedTuple):
    """A goal of a scene.

    Attributes
    ----------
    kind : {"energy", "volume", "point", "force", "mean"}
        What it is.
    name : str
        The probe or the physical group; empty for the whole body.
    components : tuple of int
        The components of a vector.
    """

    kind: str
    name: str = ""
    components: tuple[int, ...] = ()

    @property
    def is_of_group(self) -> bool:
        """Whether it names a physical group."""
        return self.kind != "point" and bool(self.name)


class Accuracy(Table):
    """The goals of the error estimate, which a scene with this table has."""

    goals: Annotated[
        list[Text],
        Field(min_length=1),
        Expect("a list of goals, e.g. 'corner.y', 'top.force.z', 'volume', 'energy'"),
        BeforeValidator(split_text),
    ] = Field(
        description="Probes and their components, corner.y; reaction forces and mean displacements "
        "of groups, top.force.z and top.mean.z; volume ratios, volume and core.volume; energy."
    )


def read_goal(text: str, probes: Sequence[Probe]) -> GoalName:
    """Return the goal of this name.

    Raises
    ------
    BadInput
        For a text that is no goal of a scene with these probes.
    """
    if text in ("energy", "volume"):
        return GoalName(text)
    rest, _, last = text.rpartition(".")
    has_component = bool(rest) and last in tuple(_AXES)
    vector = rest if has_component else text
    components = (_AXES.index(last),) if has_component else (0, 1, 2)
    names = [probe.name for probe in probes]
    if vector in names:
        return GoalName("point", vector, components)
    group, _, kind = vector.rpartition(".")
    if not group or kind not in _OF_GROUPS or (has_component and not _OF_GROUPS[kind]):
        raise bad_value("accuracy.goals", text, _ACCEPTED + nearest(vector, names))
    return GoalName(kind, group, components if _OF_GROUPS[kind] else ())
