"""A run whose kernels, numbers and mesh are in the cache: what it imports and reads."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import fem_snh
from fem_snh import materials
from fem_snh.kernels.material import compile_kernel
from fem_snh.materials.numbers import Numbers, numbers_of, stored

pytestmark = pytest.mark.one_debian

RUN = """
import sys
from fem_snh.cli import main
main("run twist --cells 2 --steps 1 --quiet".split())
modules = [n for n in sys.modules if "." not in n or not hasattr(sys.modules[n], "__path__")]
print(*modules)
"""
BASELINE = "import sys, dolfinx.fem.petsc; print(*sys.modules)"
#: Packages that take longer to import than a small solve.
SLOW = {
    "sympy", "scipy", "pycparser", "gmsh", "rich", "pandas", "matplotlib", "pyvista", "slepc4py",
}  # fmt: skip


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """An empty cache."""
    monkeypatch.setenv("FEM_SNH_CACHE", str(tmp_path))
    return tmp_path


def test_a_second_run_imports_only_what_it_needs(folder):
    def imported(code: str = RUN) -> set[str]:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return set(done.stdout.split())

    assert {"sympy", "pycparser", "gmsh"} <= imported()
    warm = imported()
    # dolfinx 0.9 imports pycparser itself.
    assert sorted(warm & SLOW - imported(BASELINE)) == [] and "sympy" not in warm
    # 115 are modules of this package (folders do not count).
    assert len([name for name in warm if name.startswith("fem_snh")]) < 116
    assert len([name for name in warm if name.startswith("fem_snh.scenes.builtin.")]) == 1


COLLECTOR = """
import gc, sys
import fem_snh.runs
from fem_snh.cli import main
before = gc.get_freeze_count()
solve = fem_snh.runs.run
def checked(*arguments, **keywords):
    print(gc.isenabled(), gc.get_freeze_count() > before)
    return solve(*arguments, **keywords)
fem_snh.runs.run = checked
arguments = "run twist --cells 1 --steps 1 --quiet".split()
sys.argv[1:] = arguments
"""


@pytest.mark.parametrize("call, frozen", [("main()", True), ("main(arguments)", False)])
def test_only_the_program_spares_its_modules_the_garbage_collector(call, frozen):
    """The collector is on during a solve; a program that calls `main` keeps its own settings."""
    code = [sys.executable, "-c", f"{COLLECTOR}\n{call}"]
    done = subprocess.run(code, capture_output=True, text=True)
    assert done.stdout.split()[:2] == ["True", str(frozen)], done.stderr


@pytest.mark.parametrize("name", materials.names())
def test_stored_numbers_are_those_of_the_energy_to_the_last_bit(folder, name):
    assert stored(name, 3e4, 0.3) is None
    made = fem_snh.material(name, 3e4, 0.3)
    again = fem_snh.material(name, 3e4, 0.3)
    expected = numbers_of(materials.make_energy(name, 3e4, 0.3), made.numbers.key)
    assert made.numbers == again.numbers == expected
    assert "expression" not in vars(again)  # no expression was made


def test_the_key_contains_all_arguments(folder):
    fem_snh.material("stable_neo_hookean", 1.0, 0.3, barrier=True)
    assert stored("stable_neo_hookean", 1.0, 0.3, barrier=True) is not None
    assert stored("stable_neo_hookean", 1, 0.3, barrier=True) is not None  # the same number
    assert stored("stable_neo_hookean", 1.0, 0.3) is None
    assert stored("stable_neo_hookean", 1.0, 0.31, barrier=True) is None
    assert stored("neo_hookean", 1.0, 0.3) is None


def test_a_damaged_record_is_made_again(folder):
    key = fem_snh.material("neo_hookean").numbers.key
    (folder / f"{key}.json").write_text('{"name": ')
    assert isinstance(fem_snh.material("neo_hookean").numbers, Numbers)
    assert json.loads((folder / f"{key}.json").read_text())["name"] == "neo_hookean"


def test_a_record_whose_library_was_deleted_compiles_it_again(folder, monkeypatch):
    m = fem_snh.material("stable_neo_hookean")
    first = compile_kernel(m)
    monkeypatch.setattr(type(m), "expression", property(lambda self: pytest.fail("generated")))
    assert compile_kernel(m) == first
    monkeypatch.undo()
    monkeypatch.setenv("FEM_SNH_CACHE", str(folder))
    first.path.unlink()
    assert compile_kernel(m) == first and first.path.exists()
