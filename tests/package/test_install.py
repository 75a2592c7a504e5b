"""What is installed holds what is needed: every package, the gmsh sources, the kernels' headers."""

from __future__ import annotations

import importlib.resources
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from datetime import date
from pathlib import Path

import pytest
from pages import PAGES, ROOT, blocks

#: The Python of the page's environment, and Debian's.
ENV, SYSTEM = "env/bin/python", "/usr/bin/python3"


def test_meshes_are_found_where_the_package_is_installed() -> None:
    found = {p.name for p in importlib.resources.files("fem_snh.meshes").iterdir()}
    assert {p.name for p in (ROOT / "meshes").glob("*.geo")} <= found


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sdist, built from a copy of the files of the repository."""
    source = tmp_path_factory.mktemp("sdist") / "source"
    ignored = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "out")
    shutil.copytree(ROOT, source, ignore=ignored)
    build = "from setuptools import build_meta; build_meta.build_sdist('dist')"
    done = subprocess.run([sys.executable, "-c", build], cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (made,) = (source / "dist").glob("*.tar.gz")
    return made


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the sdist."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*pip, "-w", folder, sdist], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (made,) = folder.glob("*.whl")
    return made


@pytest.mark.one_debian
def test_sdist_holds_the_repository(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    folders = ("benchmarks", "demos", "docs", "fem_snh", "meshes", "tests", "tools")
    wanted = {p for folder in folders for p in (ROOT / folder).rglob("*") if p.is_file()}
    wanted |= {p for p in ROOT.iterdir() if p.is_file() and not p.name.startswith(".")}
    names = {str(p.relative_to(ROOT)) for p in wanted if not {"__pycache__"} & set(p.parts)}
    assert names <= inside, names - inside


@pytest.mark.one_debian
def test_wheel_holds_every_source(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    wanted = {
        str(p.relative_to(ROOT)).replace("meshes/", "fem_snh/meshes/", 1)
        for folder in ("fem_snh", "meshes")
        for p in (ROOT / folder).rglob("*")
        if p.is_file() and p.suffix != ".pyc"
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


def test_the_dockerfile_installs_what_setup_installs() -> None:
    """`make test-docker` carries its steps out; here they are read."""
    tool = [sys.executable, str(ROOT / "tools" / "dockerfile-steps")]
    steps = subprocess.check_output(tool, text=True).splitlines()
    packages = subprocess.check_output([ROOT / "tools" / "setup", "--packages"], text=True).split()
    assert "python3-dolfinx-real" in packages and "/src/fem_snh/tools/setup --packages" in steps[3]
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    (names,) = re.findall(r"/src/fem_snh\[(.*?)\]", "\n".join(steps))
    assert set(names.split(",")) == set(extras) - {"test", "docs", "lint", "pictures"}
    assert steps[-1] == "( fem-snh doctor )"
    page = (ROOT / "docs" / "start" / "install.md").read_text()
    usage = re.findall("^#   (docker .*)", (ROOT / "Dockerfile").read_text(), re.M)
    assert len(usage) == 2 and all(f"$ {command}" in page for command in usage)


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    log = (ROOT / "CHANGELOG.md").read_text()
    (released,) = re.findall(rf"^## \[{re.escape(project['version'])}\] - (\S+)$", log, re.M)
    assert date.fromisoformat(released)
    assert f"version: {project['version']}\ndate-released: {released}\n" in citation
    # Keep a Changelog: the newest first, and below a version only these headings.
    sections = re.findall("^### (.*)", log, re.M)
    assert set(sections) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert re.findall(r"^## \[(.*?)\]", log, re.M)[0] == "Unreleased"
