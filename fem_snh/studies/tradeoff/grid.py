"""Plan the runs of a study: element by mesh, then one knob at a time or all combinations."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fem_snh import scenes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import BadInput
from fem_snh.studies.scene_points import ScenePoint, run_arguments
from fem_snh.studies.sweep import folder_name
from fem_snh.studies.tradeoff.knobs import AUTOMATIC, KNOBS, Choice, knob_values, number_text

#: Cells of the built-in scenes, from coarse to fine, up to runs of about a minute.
_PANEL = {
    **dict.fromkeys(("Q1", "Q1P0"), (4, 8, 16, 32, 64, 128)),
    "P1": (4, 8, 16, 32, 64),
    **dict.fromkeys(("Q2", "P2", "P2P0", "P2P1"), (2, 4, 8, 16, 32)),
    "Q2Q1": (2, 4, 8, 16, 24, 32, 64),
}
# Even numbers only: with odd ones the mesh has no node in the middle, which is another sequence.
_CUBE = {
    **dict.fromkeys(("Q1", "Q1P0", "P1"), (4, 6, 8, 12, 16)),
    **dict.fromkeys(("Q2", "Q2Q1"), (2, 4, 6, 8)),
    **dict.fromkeys(("P2", "P2P0", "P2P1"), (2, 4, 6)),
}
_CYLINDER = _CUBE | dict.fromkeys(("Q2", "P2", "P2P0", "P2P1"), (3, 4, 6, 8))
_CYLINDER["Q2Q1"] = (3, 4, 6, 8, 10, 12)
CELLS = {"cook": _PANEL, "twist": _CUBE, "stretch": _CYLINDER}
#: Lower bound of the cost ratio when the mesh size is halved (2 in each of two directions).
_GROWTH = 4.0


@dataclass(frozen=True)
class Plan:
    """The settings that a study runs.

    Parameters
    ----------
    nus : sequence of float
        Poisson's ratios.
    elements : sequence of str
        Names; at nu = 1/2 only Taylor-Hood elements are run.
    resolutions : mapping
        Cells or mesh files of each element, from coarse to fine.
    base : mapping
        Default settings of every element: hessian, solver, forcing, ...
    vary : sequence of str
        Knobs that are varied.
    vary_at : sequence of float, optional
        Poisson's ratios at which they are varied; None: all.
    full : bool
        Run every combination of those knobs on every mesh, instead of one at a time on one mesh.
    """

    nus: Sequence[float]
    elements: Sequence[str]
    resolutions: Mapping[str, Sequence[int | str]]
    base: Mapping[str, Any] = field(default_factory=dict)
    vary: Sequence[str] = KNOBS
    vary_at: Sequence[float] | None = None
    full: bool = False

    def choices(self, nu: float) -> list[Choice]:
        """Return the settings in the order of their runs: the grid first, and in it Taylor-Hood."""
        elements = [e for e in self.elements if nu < 0.5 or ELEMENTS[e].volume == "pressure"]
        elements.sort(key=lambda e: ELEMENTS[e].volume != "pressure")
        grid = [self.default(e, r) for e in elements for r in self.resolutions[e]]
        if self.vary_at is not None and nu not in self.vary_at:
            return grid
        if self.full:
            more = [turned for choice in grid for turned in self._product(choice)]
        else:
            middles = [self.default(e, middle_resolution(self.resolutions[e])) for e in elements]
            more = [
                turned
                for choice in middles
                for turned in choice.variations()
                if changed_knobs(turned, choice) & set(self.vary)
            ]
        return list(dict.fromkeys([*grid, *more]))

    def default(self, element: str, resolution: int | str) -> Choice:
        """Return the default settings of an element on a mesh."""
        where: dict[str, Any] = {"cells": resolution}
        if isinstance(resolution, str):
            where = {"cells": None, "mesh": resolution}
        base = dict(self.base)
        for knob in ("solver", "hessian"):  # a value of another kind of element
            if base.get(knob, AUTOMATIC) not in knob_values(element)[knob]:
                del base[knob]
        return Choice(element, **where, **base)

    def _product(self, choice: Choice) -> list[Choice]:
        lists = {knob: knob_values(choice.element)[knob] for knob in self.vary}
        chosen = itertools.product(*lists.values())
        return [replace(choice, **dict(zip(lists, values, strict=True))) for values in chosen]

    def points(
        self,
        scene: str | Path,
        nu: float,
        overrides: Mapping[str, Any],
        petsc: Mapping[str, Any] | None = None,
    ) -> dict[str, ScenePoint]:
        """Return the points at one nu by name.

        A finer mesh is run after the coarser one, and a changed knob after the default.
        """
        points = {}
        condensed = bool(scenes.why_condensed(scenes.load(scene, **overrides)))
        for choice in self.choices(nu):
            if choice.mixed and condensed:
                continue
            name = point_name(nu, choice)
            values = {"nu": nu} | dict(overrides) | choice.values()
            after, growth = self._after(choice)
            points[name] = ScenePoint(
                scene,
                values,
                scenes.load(scene, **values),
                petsc or {},
                after=None if after is None else point_name(nu, after),
                growth=growth,
                columns=choice.row()
                | {"default": not changed_knobs(choice, self._default_of(choice))},
                preparation=self._preparation(scene, choice.element, overrides),
            )
        return points

    def _preparation(
        self, scene: str | Path, element: str, overrides: Mapping[str, Any]
    ) -> list[str]:
        """Return the arguments of a run that compiles the kernels of an element, for all nu."""
        choice = self.default(element, self.resolutions[element][0])
        nu = next(nu for nu in self.nus if nu < 0.5 or ELEMENTS[element].volume == "pressure")
        values = {"nu": nu} | dict(overrides) | choice.values()
        return run_arguments(scene, None, values, {"snes_max_it": 1})

    def _after(self, choice: Choice) -> tuple[Choice | None, float]:
        """Return the choice that runs before this one, and the bound of the cost ratio."""
        all = list(self.resolutions[choice.element])
        default = self._default_of(choice)
        if choice != default:
            return default, 0.0
        at = choice.mesh or choice.cells
        number = all.index(at or 0)
        if not number:
            return None, 1.0
        coarser = all[number - 1]
        growth = _GROWTH
        if isinstance(at, int) and isinstance(coarser, int):
            growth = (at / coarser) ** 2
        return self.default(choice.element, coarser), growth

    def _default_of(self, choice: Choice) -> Choice:
        return self.default(choice.element, choice.mesh or choice.cells or 0)


def point_name(nu: float, choice: Choice) -> str:
    """Return the name of the folder of a point."""
    return folder_name([f"nu={number_text(nu)}", choice.name()])


def middle_resolution(resolutions: Sequence[int | str]) -> int | str:
    """Return the mesh on which knobs are varied: the middle one, the coarser of two."""
    return resolutions[(len(resolutions) - 1) // 2]


def changed_knobs(choice: Choice, default: Choice) -> set[str]:
    """Return the knobs in which a choice differs from the default."""
    return {knob for knob in KNOBS if getattr(choice, knob) != getattr(default, knob)}


def resolutions(
    scene: scenes.Scene, elements: Sequence[str], given: Sequence[int | str] | None
) -> dict[str, list[int | str]]:
    """Return the meshes of each element: those given, or the default ones of the scene.

    Raises
    ------
    BadInput
        If the scene has a mesh file and no meshes are given.
    """
    if given:
        return {e: list(given) for e in elements}
    if isinstance(scene.mesh, Path) and scene.cells is None:
        raise BadInput(
            f"{scene.name}: a mesh file has one resolution; give at least three of the same body, "
            "from coarse to fine: --meshes coarse.msh,middle.msh,fine.msh"
        )
    coarsest = max(1, (scene.cells or 1) // 4)
    default = {1: [coarsest * 2**k for k in range(5)], 2: [coarsest * 2**k for k in range(4)]}
    built_in = CELLS.get(scene.name, {})
    return {e: list(built_in.get(e, default[ELEMENTS[e].degree])) for e in elements}
