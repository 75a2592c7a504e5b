"""The PETSc options of a scene, its keys that a resumed run may change, and default choices."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from petsc4py import PETSc

from fem_snh import solver
from fem_snh._petsc import default_options
from fem_snh.assembly.elements import Element
from fem_snh.errors import BadInput
from fem_snh.files import file_digest
from fem_snh.problem.problem import Problem
from fem_snh.records.run_record import Record
from fem_snh.scenes import Scene
from fem_snh.solver import PREFIX
from fem_snh.steps.cell_pressures import Condensation

#: Shift of a zero diagonal, relative to Young's modulus: negligible beside a stiffness.
_SHIFT = 1e-10


@contextmanager
def scene_options(scene: Scene) -> Iterator[list[str]]:
    """Set the PETSc options of a scene, and defaults, that the user has not set. Collective.

    Yields
    ------
    list of str
        The names of the scene's options that were set.
    """
    defaults = _smoothers(min(material.E for material in scene.materials))
    with default_options(PREFIX, scene.petsc) as given, default_options(PREFIX, defaults):
        yield given


#: Keys of a scene that concern the solver: a resumed run may have other values.
SOLVER_KEYS = (
    "hessian", "globalization", "predictor", "petsc",
    "static_condensation",
)  # fmt: skip
#: Keys of a scene that concern the output of later steps, which may have other values, too.
OUTPUT_KEYS = ("fields", "fields_at", "error", "accuracy", "stability", "units")
_MAY_CHANGE = SOLVER_KEYS + OUTPUT_KEYS
_NAMED = (*_MAY_CHANGE, "time.output_every")


def identity(scene: Scene) -> Record:
    """Return the values that must not change when a run is resumed, by dotted keys.

    The value of a file, of the mesh, a material, an obstacle or a bone, is a hash of its content.
    """
    data = scene.model_dump(mode="json", exclude=set(_MAY_CHANGE))
    if scene.time:
        del data["time"]["output_every"]
    # A resumed run has the state from which it started in its checkpoint.
    files = {key: path for key, path in scene.files.items() if key != "start.run"}
    return _flat(data) | {key: _digest(key, path) for key, path in files.items()}


def _digest(key: str, path: Path) -> str:
    """Return a short hash of a file's content. Raises BadInput if it cannot be read."""
    try:
        return f"sha256 {file_digest(path)}"
    except OSError as error:
        raise BadInput(f"{key}: cannot read {path}: {error.strerror}") from None


def _flat(value: Any, key: str = "") -> Record:
    """Return nested tables as one table with dotted keys."""
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: v for name, part in items for k, v in _flat(part, f"{key}.{name}").items()}
    return {key.removeprefix("."): value}


def check_same(folder: Path, before: Record, now: Record) -> None:
    """Raise BadInput for the first key whose value is not that of the checkpoint."""
    for key in dict.fromkeys([*before, *now]):
        if before.get(key) != now.get(key):
            raise BadInput(
                f"cannot resume {folder}: {key} = {_text(now, key)}: expected {_text(before, key)} "
                f"as before; only {', '.join(_NAMED)} and the number of ranks may change"
            )


def _text(scene: Record, key: str) -> str:
    """Return a key's value as text, or "no value"."""
    return json.dumps(scene[key]) if key in scene else "no value"


def _smoothers(E: float) -> Record:
    """Return PETSc options that make SOR sweeps the smoothers of multigrid.

    They hold for displacements, and for the displacement block of a saddle-point problem. PETSc's
    default is a Chebyshev polynomial up to an estimated largest eigenvalue; if a filtered Hessian
    has larger ones, the preconditioner is indefinite. An aggregate of one node has fewer unknowns
    than rigid motions, so the coarser matrix has a zero on its diagonal, which is shifted.

    Parameters
    ----------
    E : float
        The smallest Young's modulus [Pa] of the materials.
    """
    sweeps = {"ksp_type": "richardson", "pc_type": "sor", "pc_sor_diagonal_shift": _SHIFT * E}
    blocks = ("", "fieldsplit_u_")
    return {f"{b}mg_levels_{key}": value for b in blocks for key, value in sweeps.items()}


#: Why a Hessian is ``adaptive`` (docs/results/which_hessian.md).
_HESSIAN = (
    "exact while the linear solver finds it positive definite, which takes the fewest Newton "
    "iterations; filtered where it is not"
)
#: Reasons of a globalization.
_NAMED_HESSIAN = "the Hessian was chosen, and a line search is the method that it is known with"
_MINIMUM = "the problem minimises an energy, so that negative curvature can be followed"
_SADDLE = "Taylor-Hood elements give a saddle-point problem, which has no energy to minimise"
_FORCES = "a force without an energy: there is nothing to minimise"


def describe_condensation(about: Record, element: Element, chosen: Condensation) -> None:
    """Add ``static_condensation``, if the element has cell pressures, to the record ``about``.

    If the pressures are unknowns, ``linear_solver`` is the solver of the problem with pressures.
    """
    if element.volume != "mean":
        return
    about["static_condensation"] = condensed = chosen.pressures is None
    if chosen.pressures is not None:
        snes = chosen.pressures.snes
        about["linear_solver"] = name = solver.linear_solver_name(snes)
        if reason := snes.getPythonContext().linear_choice.reason:
            about["defaults"]["linear_solver"] = {"value": name, "reason": reason}
    if chosen.reason:
        entry = {"value": condensed, "reason": chosen.reason}
        about["defaults"]["static_condensation"] = entry


def describe_defaults(scene: Scene, problem: Problem, snes: PETSc.SNES) -> dict[str, object]:
    """Return ``{choice: {"value", "reason"}}`` for what neither scene nor PETSc options set."""
    database, context = PETSc.Options(solver.PREFIX), snes.getPythonContext()
    found: dict[str, object] = {}

    def add(key: str, value: object, reason: str) -> None:
        found[key] = {"value": value, "reason": reason}

    named = scene.hessian is not None or database.hasName("snes_hessian")
    if not named:
        add("hessian", context.options["snes_hessian"], _HESSIAN)
    if scene.globalization is None and not database.hasName("snes_globalization"):
        reason = _MINIMUM if problem.has_energy else _FORCES
        reason = _SADDLE if problem.saddle_point else reason
        reason = _NAMED_HESSIAN if named else reason
        add("globalization", context.options["snes_globalization"], reason)
    if context.linear_choice.reason:
        add("linear_solver", solver.linear_solver_name(snes), context.linear_choice.reason)
    if scene.quadrature is None:
        add("quadrature", problem.element.quadrature, f"the degree of {scene.element}")
    return found
