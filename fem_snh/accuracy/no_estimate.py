"""Why there is no estimate of an error."""

from __future__ import annotations

from fem_snh.errors import in_words
from fem_snh.problem.problem import Problem
from fem_snh.problem.solids import solids_in_shapes


class NoEstimate(Exception):
    """There is no estimate of the error; the text says why in one line."""


class ElementDoesNotFit(NoEstimate):
    """The problem cannot have this element; another one may do."""


class StepsTooLong(NoEstimate):
    """Steps fail on a path that is followed again with fewer of them; shorter ones may not."""


class TooLittleMemory(NoEstimate):
    """The lifted problem needs more memory than it may have."""


class NoEstimateOnAnyMesh(NoEstimate):
    """There is none for a reason that a finer mesh does not change."""


def depends_on_path(problem: Problem) -> bool:
    """Return whether a state depends on those before it: in time, with friction. Collective."""
    return problem.motion is not None or problem.history.is_kept(problem.comm)


def check_body(problem: Problem) -> None:
    """Raise NoEstimate for a solid that is a shape, whose surface cells follow step by step."""
    if solids := solids_in_shapes(problem):
        raise NoEstimateOnAnyMesh(
            f"the {solids[0].kind} '{solids[0].name}' is a shape: in time, and with friction or "
            "multipliers, it needs a 'group' of the mesh"
        )


def check_problem(problem: Problem) -> None:
    """Raise NoEstimate for a state that depends on its path. Collective."""
    again = "follow the path by steps() of the problem, from its beginning"
    if problem.motion:
        raise NoEstimateOnAnyMesh(f"the motion is another one in another element: {again}")
    if problem.history.is_kept(problem.comm):
        names = in_words(f"'{name}'" for name in problem.history.by_name)
        raise NoEstimateOnAnyMesh(
            f"{names} keeps friction or multipliers from step to step, which another element "
            f"does not have: {again}"
        )
