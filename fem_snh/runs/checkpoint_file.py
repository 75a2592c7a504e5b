"""Read checkpoint.npz and check what is in it: a file may be damaged, or of another version."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.kinematics import PLANAR, kinematics_of
from fem_snh.errors import BadInput, shown
from fem_snh.files import open_file
from fem_snh.records.run_files import CHECKPOINT
from fem_snh.records.run_record import is_number, problem

Array = npt.NDArray[Any]


def load(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Read a run's checkpoint. Not collective.

    Parameters
    ----------
    folder : Path
        The folder of the output.

    Returns
    -------
    about : dict
        The scene, the record, the loads and the size of the next step.
    arrays : dict
        "u" (n, components), the displacements [m]; "u_nodes" (n, 3), the reference coordinates [m]
        of their nodes; "u_before", the previous equilibrium; the same for a pressure "p" (n, 1);
        "motion", and "NAME_points" and "NAME_history" of terms.

    Raises
    ------
    BadInput
        If there is no checkpoint, or it cannot be read.
    """
    path = folder / CHECKPOINT
    try:
        with open_file(path) as file, np.load(file, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
        about = json.loads(arrays.pop("about").tobytes())
    except FileNotFoundError:
        raise BadInput(
            f"{folder} has no {CHECKPOINT} to resume from: start without --resume"
            + (", with --overwrite" if (folder / "run.json").exists() else "")
        ) from None
    except Exception as error:  # zipfile, zlib, numpy and json raise different ones
        raise unusable(folder, str(error) or type(error).__name__) from None
    if reason := _mistake(about, arrays):
        raise unusable(folder, reason)
    return about, arrays


def unusable(folder: Path, reason: str) -> BadInput:
    """Return the exception for a checkpoint that cannot be used."""
    return BadInput(
        f"{folder / CHECKPOINT} cannot be read ({reason}): start again with --overwrite"
    )


def _mistake(about: Any, arrays: dict[str, Array]) -> str:
    """Return why the content of a checkpoint cannot be that of a run, or ""."""
    if not isinstance(about, dict):
        return f"about = {shown(about)}: expected a table"
    names = ("scene", "record", "load", "load_before", "size", "motion", "diagonal")
    if missing := [name for name in names if name not in about]:
        return f"{missing[0]}: missing"
    if not isinstance(about["scene"], dict):
        return f"scene = {shown(about['scene'])}: expected a table"
    if reason := problem(about["record"]):
        return f"record: {reason}"
    for key in ("load", "load_before"):
        load = about[key]
        if not (load is None and key == "load_before") and not (is_number(load) and 0 <= load <= 1):
            return f"{key} = {shown(load)}: expected a number from 0 to 1"
    for key in ("size", "diagonal"):
        if about[key] is not None and not (is_number(about[key]) and about[key] > 0):
            return f"{key} = {shown(about[key])}: expected a number > 0"
    kinematics = about["scene"].get("kinematics")
    if kinematics is not None and kinematics not in list(PLANAR):
        return f"kinematics = {shown(kinematics)}: expected one of {', '.join(PLANAR)}"
    components = kinematics_of(kinematics).components
    if reason := _motion_mistake(about["motion"], arrays, components):
        return reason
    for name, columns in (("u", components), ("p", 1)):
        if name == "p" and not {"p", "p_nodes", "p_before"} & arrays.keys():
            continue
        nodes = len(arrays.get(f"{name}_nodes", ()))
        shapes = {f"{name}_nodes": (nodes, 3), name: (nodes, columns)}
        if about["load_before"] is not None:
            shapes[f"{name}_before"] = (nodes, columns)
        for key, shape in shapes.items():
            if reason := _array_mistake(arrays, key, shape):
                return reason
    return ""


def _motion_mistake(motion: Any, arrays: dict[str, Array], components: int) -> str:
    """Return what is wrong with the history of a motion in time, or ""."""
    if motion is None:
        return ""
    fields = motion.get("fields") if isinstance(motion, dict) else None
    if not isinstance(fields, list) or not all(isinstance(name, str) for name in fields):
        return f"motion = {shown(motion)}: expected a table with fields"
    numbers = ["dissipated", "work", *(["step_before"] if "u_before" in fields else [])]
    for key in (*numbers, *(["first_energy"] if "first_energy" in motion else [])):
        if not is_number(motion.get(key)):
            return f"motion.{key} = {shown(motion.get(key))}: expected a number"
    shape = len(arrays.get("u_nodes", ())), components * len(fields)
    return _array_mistake(arrays, "motion", shape)


def _array_mistake(arrays: dict[str, Array], name: str, shape: tuple[int, int]) -> str:
    """Return what is wrong with an array of numbers, or ""."""
    if name not in arrays:
        return f"{name}: missing"
    values = arrays[name]
    if values.shape != shape or values.dtype != np.float64:
        return f"{name}: expected {shape[0]} x {shape[1]} numbers, found shape {values.shape}"
    return "" if np.isfinite(values).all() else f"{name}: expected finite numbers"
