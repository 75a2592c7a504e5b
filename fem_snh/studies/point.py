"""One point of a study: the command that computes it, its limits and its row of the table.

`fem_snh.studies.batch` runs the points; `fem_snh.studies.scene_points` has those that run scenes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from fem_snh.errors import BadInput, check_whole
from fem_snh.studies.schedulers import Submission

#: Largest number of points at a time, and of ranks: more than the cores of any single machine.
MAX_PROCESSES = 4096


@dataclass(frozen=True)
class Limits:
    """The number of points that run at a time, and the limits of each.

    Parameters
    ----------
    jobs : int or Submission
        Points at a time on this machine, or how they are submitted to a scheduler.
    ranks : int
        MPI ranks of each point.
    timeout : float, optional
        Seconds after which a point is given up; None: never.
    memory : float, optional
        Resident memory above which a point is given up [GiB]; None: no limit.

    Raises
    ------
    BadInput
        For a value outside its range.
    """

    jobs: int | Submission = 1
    ranks: int = 1
    timeout: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        for key in ("jobs", "ranks"):
            if not isinstance(number := getattr(self, key), Submission):
                check_whole(key, number, 1, MAX_PROCESSES)
        for key, unit in {"timeout": "seconds", "memory": "GiB"}.items():
            limit = getattr(self, key)
            number = isinstance(limit, int | float) and not isinstance(limit, bool)
            if limit is not None and not (number and limit > 0):
                raise BadInput(f"{key} = {limit}: expected {unit}, a number > 0")


class Point(ABC):
    """A command that writes run.json into its folder, and the row made of it.

    Attributes
    ----------
    module : str
        The module that is run.
    """

    module: ClassVar[str] = "fem_snh"

    @abstractmethod
    def arguments(self, folder: Path) -> list[str]:
        """Return the arguments of the module for a point that writes into ``folder``."""

    def files(self) -> Sequence[Path]:
        """Return the files whose content its row depends on."""
        return ()

    @abstractmethod
    def requested(self) -> Mapping[str, Any]:
        """Return the columns of its settings."""

    @abstractmethod
    def measured(self, record: Mapping[str, Any], log: Path, code: int) -> Mapping[str, Any]:
        """Return the columns of its results: ``converged``, ``status``, ``seconds`` and others.

        Parameters
        ----------
        record : mapping
            The record that it wrote; empty if there is none.
        log : Path
            Its output.
        code : int
            Its exit code.
        """
