"""What is installed holds what is needed: every package, the gmsh sources, the kernels' headers."""

from __future__ import annotations

import importlib.resources
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from pages import PAGES, ROOT, blocks

#: The Python of the page's environment, and Debian's.
ENV, SYSTEM = "env/bin/python", "/usr/bin/python3"


def test_meshes_are_found_where_the_package_is_installed() -> None:
    found = {p.name for p in importlib.resources.files("fem_snh.meshes").iterdir()}
    assert {p.name for p in (ROOT / "meshes").glob("*.geo")} <= found


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy of the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for name in ("fem_snh", "meshes", "benchmarks"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*pip, "-w", folder, source], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (made,) = folder.glob("*.whl")
    return made


def test_wheel_holds_every_source(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    wanted = {
        str(p.relative_to(ROOT)).replace("meshes/", "fem_snh/meshes/", 1)
        for folder in ("fem_snh", "meshes")
        for p in (ROOT / folder).rglob("*")
        if p.suffix in {".py", ".h", ".geo"}
    }
    assert wanted <= inside, wanted - inside
    # What measures the program, and what injects faults into it, is not installed.
    assert not [name for name in inside if {"benchmarks", "faults"} & set(Path(name).parts)]


def test_the_lines_of_the_install_page_work_outside_the_repository(wheel: Path) -> None:
    """They keep Debian's numpy, for which petsc4py and dolfinx are compiled, and run a scene."""
    page = next(page for page in PAGES if page.name == "install.md")
    (block,) = (block for block in blocks(page) if "pip install" in block.text)
    lines = [line.removeprefix("$ ") for line in block.text.splitlines()]
    assert lines[-1] == "env/bin/fem-snh run stretch"
    lines[-1] += " --cells 3 --steps 1 --out run"
    outside = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        ["bash", "-ec", "\n".join(lines)],
        cwd=wheel.parent,
        env=outside | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((wheel.parent / "run" / "run.json").read_text())
    show = ["-Ic", "import numpy; print(numpy.__version__)"]
    installed, debian = (
        subprocess.check_output([python, *show]) for python in (wheel.parent / ENV, SYSTEM)
    )
    assert record["converged"] and installed == debian
