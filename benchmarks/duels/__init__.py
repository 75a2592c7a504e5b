"""Duels with other programs: seconds to one per cent of the same number, by scene and program.

Each peer runs in a virtual environment of its own, which is made from pinned packages of PyPI if it
is missing. Scenes and energy are the same for all, those of `benchmarks.duels.scenes`.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from benchmarks import Row, search_path, split_list
from benchmarks.duels import cylinder
from fem_snh import cache
from fem_snh.errors import choose
from fem_snh.files import replace_file

#: An error of the number below this ends the ladder of meshes.
WITHIN = 0.01
#: Of the inverted cube: the largest distance [side] of a node from its place, where a body is back.
BACK = 0.01
#: A program that takes less is run twice, and the faster run counts: kernels are then compiled [s].
AGAIN = 20.0
#: Meshes by scene, from coarse to fine: degree of the element and cells.
LADDERS: dict[str, tuple[tuple[int, int], ...]] = {
    "twist": ((2, 3), (2, 4), (2, 6), (2, 8)),
    "bar": ((1, 2), (1, 3), (1, 4)),
    "cook": ((1, 16), (1, 32), (1, 48)),
    "hertz": ((1, 8), (1, 12), (1, 16)),
    "blocks": ((1, 2), (1, 3), (1, 4)),
    "inverted": ((1, 4),),
}
_DEGREE_2 = ((2, 8), (2, 16), (2, 32))
_NO_CONTACT = "none: it has no contact"
_ENERGIES = ("stable_neo_hookean", "neo_hookean_simo")


class Peer(NamedTuple):
    """A program to compare with.

    Attributes
    ----------
    requirements : tuple of str
        Its packages, of which the first is its own; none: this program.
    ladders : mapping
        Meshes where they are not those of `LADDERS`, or why it has no such scene.
    system : bool
        Whether its environment has the system's packages: petsc4py is no wheel.
    energy : str
        That of its results, of which the reference is computed.
    """

    requirements: tuple[str, ...]
    ladders: Mapping[str, tuple[tuple[int, int], ...] | str]
    system: bool = False
    energy: str = _ENERGIES[0]


PEERS = {
    "fem_snh": Peer((), {"cook": ((2, 4), (2, 8), (2, 16)), "hertz": ((2, 4), (2, 6), (2, 8))}),
    "fem_snh --accuracy": Peer(
        (), dict.fromkeys(LADDERS, ((0, 4),)) | {"inverted": "none: a run without a goal"}
    ),
    "felupe": Peer(
        ("felupe==11.3.0", "pypardiso==0.4.7"), {"blocks": "none: rigid bodies alone touch others"}
    ),
    "sfepy": Peer(
        ("sfepy==2026.3", "numpy==1.26.4", "pypardiso==0.4.7"), {"cook": ((2, 4), (2, 8))}
    ),
    "fedoo": Peer(
        ("fedoo==1.1.0", "simcoon==2.2.0", "pypardiso==0.4.7"), {}, energy=_ENERGIES[1]
    ),
    "easyfea": Peer(
        ("EasyFEA==7.1.0", "jax==0.10.2", "pypardiso==0.4.7"),
        {"cook": _DEGREE_2, "hertz": _NO_CONTACT, "blocks": _NO_CONTACT},
    ),
    "jax_fem": Peer(
        (
            "jax-fem==0.0.11", "jax==0.4.38", "jaxlib==0.4.38", "ml_dtypes==0.5.1",
            "fenics-basix==0.9.0", "meshio==5.3.5", "gmsh==4.15.0", "pyfiglet==1.0.4",
            f"numpy=={np.__version__}",  # that of the system's petsc4py
        ),
        {"cook": _DEGREE_2, "hertz": _NO_CONTACT, "blocks": _NO_CONTACT},
        system=True,
    ),
    "newton": Peer(
        ("newton==1.8.0", "warp-lang==1.19.0"),
        {"twist": ((1, 6), (1, 10))}
        | dict.fromkeys(("cook", "hertz", "blocks"), "none: it holds points, no single components"),
    ),
}  # fmt: skip
_HERE = Path(__file__).parent
#: The references of the numbers, which the option ``references`` makes.
DATA = _HERE / "references.json"


def rows(
    peers: str = "",
    scenes: str = "",
    environments: str = "",
    limit: float = 120.0,
    table: str = "",
    references: str = "",
) -> Iterator[Row]:
    """Yield one row per program and scene, from coarse meshes on until the error is below 1 %.

    Parameters
    ----------
    peers, scenes : comma list
        Programs and scenes; default: all, then Smith's cylinder, the scene ``cylinder``.
    environments : str
        Folder of the virtual environments; default: ``peers`` in the cache folder.
    limit : float
        Longest time of a program on one mesh [s].
    table : str
        A file of CSV to which the rows are written, too.
    references : str
        A file of JSON to which the references are written instead.

    Yields
    ------
    dict
        ``number`` and its ``error`` relative to ``reference``, ``seconds`` of the program without
        imports and ``with_imports``, ``newton`` iterations, ``status`` in the peer's words,
        ``tried``: degree, cells, error and seconds of the coarser meshes. Distances of the inverted
        cube are errors themselves.
    """
    if references:
        _write_references(Path(references))
        yield {"written": references}
        return
    done = []
    place = Path(environments) if environments else cache.folder() / "peers"
    chosen = split_list(scenes) or [*LADDERS, cylinder.NAME]
    for name in split_list(peers) or PEERS:
        peer = PEERS[choose("peers", name, PEERS)]
        python, reason = environment(name, peer, place)
        for scene in chosen:
            if scene == cylinder.NAME:
                if name == "fem_snh":
                    yield cylinder.row()
                continue
            ladder = peer.ladders.get(choose("scenes", scene, LADDERS), LADDERS[scene])
            row: Row = {"peer": name, "scene": scene, "version": ", ".join(peer.requirements[:2])}
            if isinstance(ladder, str) or reason:
                row |= {"status": reason or ladder, "within": None}
            else:
                row |= climb(name, peer, scene, ladder, python, limit)
            done.append(row)
            yield row
    if table:
        _write_table(Path(table), done)


def _write_references(path: Path) -> None:
    """Compute and store the references."""
    from benchmarks.duels.ours_program import references

    with TemporaryDirectory() as folder:
        found = {energy: references(Path(folder), energy) for energy in _ENERGIES}
    command = f"python -m benchmarks duels --references {path}"
    replace_file(path, json.dumps({"command": command, "values": found}, indent=2) + "\n")


def _write_table(path: Path, done: list[Row]) -> None:
    """Write the rows as CSV for the page of results."""
    import pandas as pd

    def text(key: str, pattern: str) -> list[str]:
        values = (row.get(key) for row in done)
        return ["" if value is None else format(value, pattern) for value in values]

    columns = {
        "scene": text("scene", ""),
        "program": text("peer", ""),
        "degree": text("degree", ""),
        "cells": text("cells", ""),
        "unknowns": text("unknowns", ",d"),
        "error": text("error", ".2g"),
        "Newton": text("newton", ""),
        "seconds": text("seconds", ".3g"),
        "with imports": text("with_imports", ".3g"),
        "status": text("status", ""),
    }
    frame = pd.DataFrame(columns).sort_values("scene", kind="stable", key=_position)
    path.parent.mkdir(exist_ok=True)
    frame.to_csv(path, index=False)


def _position(scenes: Any) -> Any:
    """Return the places of scenes in the order of `LADDERS`."""
    return scenes.map(list(LADDERS).index)


def environment(name: str, peer: Peer, place: Path) -> tuple[str, str]:
    """Return the Python that has a peer, made if it is missing, and why there is none."""
    if not peer.requirements:
        return sys.executable, ""
    folder, wanted = place / name, "\n".join(peer.requirements)
    python, done = folder / "bin" / "python", folder / "requirements.txt"
    if done.exists() and done.read_text(encoding="utf-8") == wanted:
        return str(python), ""
    place.mkdir(parents=True, exist_ok=True)
    system = ["--system-site-packages"] if peer.system else []
    for command in (
        [sys.executable, "-m", "venv", "--clear", *system, str(folder)],
        [str(python), "-m", "pip", "install", "--quiet", *peer.requirements],
    ):
        made = subprocess.run(command, capture_output=True, text=True)
        if made.returncode:
            said = [line for line in made.stderr.splitlines() if "ERROR" in line] or ["pip failed"]
            return "", f"cannot be installed: {said[-1][:200]}"
    done.write_text(wanted, encoding="utf-8")
    return str(python), ""


def climb(
    name: str,
    peer: Peer,
    scene: str,
    ladder: tuple[tuple[int, int], ...],
    python: str,
    limit: float,
) -> Row:
    """Return the row of the first mesh whose number is within 1 %, or of the last one."""
    reference, tried, row = reference_of(scene, peer.energy), list[Any](), Row()
    for degree, cells in ladder:
        row = run_program(name, python, (scene, degree, cells), limit)
        if row.get("with_imports", limit) < AGAIN:
            row = min(row, run_program(name, python, (scene, degree, cells), limit), key=_seconds)
        number, bound = row.get("number"), BACK if scene == "inverted" else WITHIN
        error = None
        if number is not None:
            error = number if scene == "inverted" else abs(number / reference - 1)
        row = {"reference": reference, "degree": degree, "cells": cells, "error": error} | row
        row["within"] = error is not None and error <= bound
        if row["within"]:
            break
        tried.append([degree, cells, error and float(f"{error:.2g}"), row.get("seconds")])
    return row | {"tried": tried[:-1] if not row["within"] else tried}


def _seconds(row: Row) -> float:
    """Return the seconds of a run."""
    return float(row.get("seconds", math.inf))


def reference_of(scene: str, energy: str) -> float:
    """Return the reference of a number."""
    if scene == "inverted":
        return 0.0
    if scene == "cook":  # the energies agree to 0.01 % near nu = 1/2
        from benchmarks.accuracy_cases import exact

        return exact("cook, nu 0.4999")[0]
    values = json.loads(DATA.read_text(encoding="utf-8"))["values"]
    return float(values[energy][scene]["value"])


def run_program(name: str, python: str, arguments: tuple[Any, ...], limit: float) -> Row:
    """Return what the program of a peer prints, or why it prints nothing."""
    ours = name.startswith("fem_snh")
    program = ["-m", f"{__name__}.ours_program"] if ours else [str(_HERE / f"{name}_program.py")]
    jax = {"JAX_COMPILATION_CACHE_DIR": str(cache.folder() / "jax"), "JAX_PLATFORMS": "cpu"}
    jax["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    start = perf_counter()
    try:
        done = subprocess.run(
            [python, *program, *map(str, arguments)],
            env=os.environ | jax | (search_path() if ours else {"PYTHONPATH": ""}),
            capture_output=True, text=True, timeout=limit,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"number": None, "status": f"no end within {limit:g} s"}
    elapsed, lines = perf_counter() - start, done.stdout.splitlines()
    if done.returncode or not lines:
        reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        return {"number": None, "status": reason[:200], "with_imports": round(elapsed, 2)}
    row: Row = json.loads(lines[-1])
    row["status"] = row["status"][:200]
    return row | {"seconds": round(row["seconds"], 3), "with_imports": round(elapsed, 2)}
