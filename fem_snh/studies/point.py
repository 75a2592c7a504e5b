"""One point of a study: the command that computes it, its limits and its row of the table.

`fem_snh.studies.batch` runs the points; `fem_snh.studies.scene_points` has those that run scenes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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


@dataclass(frozen=True, kw_only=True)
class Point(ABC):
    """A command that writes a record into its folder, and the row made of that record.

    Parameters
    ----------
    timeout : float, optional
        Timeout of this point, in place of the one in `Limits`.
    after : str, optional
        Name of a point that must have ended before this one starts: a coarser mesh.
    growth : float
        Lower bound of the time of this point over that of ``after``. If the product exceeds the
        timeout, or ``after`` reached a limit itself, this point is skipped.
    columns : mapping
        Further columns of its row, whatever its result.
    preparation : sequence of str
        Arguments of ``fem-snh`` that compile what it needs. They are run once, before the first
        point that has them, so that its row does not contain the time of the compiler.

    Attributes
    ----------
    module : str
        The module that is run.
    parallel : bool
        Whether it is started on several ranks.
    record : str
        The file that it writes into its folder.
    """

    timeout: float | None = None
    after: str | None = None
    growth: float = 1.0
    columns: Mapping[str, Any] = field(default_factory=dict)
    preparation: Sequence[str] = ()

    module: ClassVar[str] = "fem_snh"
    parallel: ClassVar[bool] = True
    record: ClassVar[str] = "run.json"

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
