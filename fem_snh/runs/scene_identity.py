"""Compare the scene of a resumed run with the scene of its checkpoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput
from fem_snh.files import file_digest
from fem_snh.scenes import Scene

#: Keys of a scene that concern the solver: a resumed run may have other values.
SOLVER_KEYS = (
    "hessian", "globalization", "assembly", "predictor", "petsc",
    "static_condensation",
)  # fmt: skip
#: Keys of a scene that concern the output of later steps: likewise.
OUTPUT_KEYS = ("fields", "fields_at", "error", "accuracy", "stability", "units")
_MAY_CHANGE = SOLVER_KEYS + OUTPUT_KEYS
_NAMED = (*_MAY_CHANGE, "time.output_every")


def identity(scene: Scene) -> dict[str, Any]:
    """Return the values that must not change when a run is resumed, by dotted keys.

    A mesh file, a material's Python file and the files of obstacles and bones are compared by
    their content, not by their path.
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


def _flat(value: Any, key: str = "") -> dict[str, Any]:
    """Return nested tables as one table with dotted keys."""
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: v for name, part in items for k, v in _flat(part, f"{key}.{name}").items()}
    return {key.removeprefix("."): value}


def check_same(folder: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    """Raise BadInput for the first key whose value is not that of the checkpoint."""
    for key in dict.fromkeys([*before, *now]):
        if before.get(key) != now.get(key):
            raise BadInput(
                f"cannot resume {folder}: {key} = {_text(now, key)}: expected {_text(before, key)} "
                f"as before; only {', '.join(_NAMED)} and the number of ranks may change"
            )


def _text(scene: dict[str, Any], key: str) -> str:
    """Return a key's value as text, or "no value"."""
    return json.dumps(scene[key]) if key in scene else "no value"
