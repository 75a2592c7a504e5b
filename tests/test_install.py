"""What is installed holds what is needed: every package, the gmsh sources, the kernels' headers."""

from __future__ import annotations

import importlib.resources
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_meshes_are_found_where_the_package_is_installed() -> None:
    found = {p.name for p in importlib.resources.files("fem_snh.meshes").iterdir()}
    assert {p.name for p in (ROOT / "meshes").glob("*.geo")} <= found


def test_wheel_holds_every_source(tmp_path: Path) -> None:
    source = tmp_path / "source"
    for folder in ("fem_snh", "meshes", "benchmarks"):
        shutil.copytree(
            ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "setup.py", "LICENSE", "README.md"):
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*pip, "-w", tmp_path, source], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
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
