"""Command lines: those of a run, and every command and option with a value that is wrong."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from functools import cache
from pathlib import Path
from random import Random

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import WHOLE
from fem_snh import cli
from fem_snh.cli.options import Parser
from fem_snh.studies.tasks import environment, program

_SCENE = """\
mesh = { source = "cube" }
cells = 1
element = "Q1"
[material]
name = "stable_neo_hookean"
E = 1.0
nu = 0.3
[[hold]]
group = "bottom"
[[move]]
group = "top"
translate = [0, 0, -0.1]
"""
#: Values of options; none is a number of cells, of steps or of processes that would take hours.
_VALUES = (
    "", " ", "x", "0", "-1", "1", "2", "0.3", "nan", "inf", "-inf", "1e308", "1e-320", "true",
    "False", "[]", "[1, 2]", "{}", "{ a = 1 }", "'", '"', "1,2", ",", "0.3,,0.4", "a=b", "=",
    "material.E=x",
    "steps=0", "nowhere", "scene.toml", ".", "file", "file/folder", "/dev/null", "\x1b[0m",
    "na\u00efve", "9" * 400, "9999999999", "A" * 5000,
    "--", "-", "--nonsense", "-x", "top", "clamp", "P2", "Q1P0",
    "mooney_rivlin", "hold.0.group=botom", "material.nu=0.5", "reactions=top,bottom", "petsc.x=1",
    "mesh=", "table.0=1", "hold=1", "hold.5.group=1", "a.b.c.d=1", "..=1", "gravity.vector=1,2",
)  # fmt: skip
#: Commands whose valid calls take minutes or hours: they get an option that no command has.
_LONG = ("sweep", "compile")
_PETSC = (
    ("-ksp_rtol", "x"), ("-snes_max_it", "-1"), ("-snes_hessian", "x"), ("1e-6",), ("-",), ("--",),
    ("-snes_rtol", "nan"), ("-snes_max_it", "3"), ("-pc_type", "nonsense"),
    ("-ksp_type", "nonsense"),
)  # fmt: skip


#: Options that leave the answer as it is.
_HARMLESS = (
    ["--nu", "0.3"], ["--set", "material.nu=0.3"], ["--E=1"], ["--element", "Q1"], ["--steps=1"],
    ["--hessian", "clamp"], ["--globalization", "linesearch"], ["--set=reactions=['top']"],
    ["--material", "stable_neo_hookean"], ["--set", "fields=['von_mises']"],
)  # fmt: skip


def make_command(random: Random, folder: Path) -> list[str]:
    """Command lines of a run with options that do not change it, or one of any command changed"""
    (folder / "scene.toml").write_text(_SCENE)
    (folder / "file").write_text("no scene, no run, no mesh\n")
    words = ["run", "scene.toml", "--cells", "1", "--out", "out"]
    if random.random() < WHOLE:
        chosen = random.sample(_HARMLESS, random.randrange(4))
        given = {option[0].partition("=")[0] for option in chosen}
        if len(given) < len(chosen) or {"--nu", "--set"} <= given:
            chosen = chosen[:1]
        return ["whole", *words, *(word for option in chosen for word in option)]
    name = random.choice((*cli.COMMANDS, "run", "run", "run", "materials", random.choice(_VALUES)))
    if name != "run":
        words = [name]
    change = random.randrange(3 if name in ("run", *_LONG) else 2)
    if change == 0:
        words += _option(random, cli.parsers().get(name))
    elif change == 1:
        words.insert(random.randrange(1, len(words) + 1), random.choice(_VALUES))
    if name in _LONG:
        words.insert(random.randrange(1, len(words) + 1), "--nonsense")
    if change == 2:
        words += ["--", *random.choice(_PETSC)]
    return ["changed", *words]


def _main(arguments: list[str]) -> int:
    """Run a command; a whole one has the energy of the scene."""
    code = cli.main(arguments[1:])
    _check_energy(arguments[0])
    return code


def _check_energy(state: str) -> None:
    """Raise AssertionError unless out/run.json has the energy of the scene, if it was whole."""
    if state == "whole":
        found = json.loads(Path("out/run.json").read_text())["steps"][-1]["energy"]
        assert math.isclose(found, _energy(), rel_tol=1e-6), found


@cache
def _energy() -> float:
    import fem_snh

    return float(fem_snh.run("scene.toml", progress=False).steps[-1]["energy"])


def _option(random: Random, parser: Parser | None) -> list[str]:
    """Return an option of a command, misspelt or not, with a value, in one word or two, or none."""
    known = [w for w in parser._option_string_actions if w.startswith("--")] if parser else []
    known = [word for word in known if word not in ("--jobs", "--ranks", "--help", "--accuracy")]
    option = random.choice(known or ["--x"])
    if random.random() < 0.1:
        at = random.randrange(2, len(option) + 1)
        option = option[:at] + "x" + option[at:]
    value = random.choice(_VALUES)
    return random.choice(([option, value], [option, value], [f"{option}={value}"], [option]))


def make_ranks(random: Random, folder: Path) -> list[str]:
    """The same command lines on two ranks"""
    while True:
        words = make_command(random, folder)
        if words[1] in ("run", "plot", "render", "view") and "--" not in words:
            return words


def _on_two_ranks(arguments: list[str]) -> int:
    """Run ``fem-snh`` under mpirun; keep what the program itself prints on standard error."""
    command = [*program(2), *arguments[1:]]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, env=environment(), capture_output=True, text=True
    )
    own = ("fem-snh: ", "Traceback")
    for line in done.stderr.splitlines():
        if line.startswith(own):
            print(line, file=sys.stderr)
    _check_energy(arguments[0])
    return done.returncode


FAMILIES = {
    "command": Family(make_command, _main, ("fem_snh.runs",)),
    "ranks": Family(make_ranks, _on_two_ranks),
}
