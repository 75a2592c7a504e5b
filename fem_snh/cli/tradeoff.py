"""The command ``tradeoff``: run an accuracy-cost study of a scene and recommend settings."""

from __future__ import annotations

from typing import Any

from fem_snh.cli import study_options
from fem_snh.cli.options import Parser, assignments, output, split_petsc, value
from fem_snh.cli.run import scene_list
from fem_snh.errors import BadInput

#: Default limits of a point [s, GiB].
TIMEOUT, MEMORY = 120.0, 4.0
_DEFAULTS = {
    "hessian": "automatic, or exact, clamp, abs or adaptive with a line search",
    "solver": "automatic, cg+ssor, +jacobi, +icc, +gamg, direct; Q1P0, P2P0: mixed+fgmres, "
    "+direct; Taylor-Hood: fgmres+ssor, minres+hypre, +gamg, +icc, direct",
    "forcing": "largest relative tolerance of a linear solve",
    "tolerance": "of the residual, relative to E V^(2/3)",
    "steps": "load steps",
}


def tradeoff_parser() -> Parser:
    """Return the parser of ``fem-snh tradeoff``."""
    parser = Parser(
        "tradeoff",
        "Run an accuracy-cost study of a scene: elements by meshes, then one setting at a time\n"
        "(Hessian policy, linear solver, forcing, tolerance), each in its own\n"
        "process. Errors are relative to a reference solution computed from the finest meshes. An\n"
        "interrupted study continues; with more --nu, --elements or --cells only new points run.",
        scene_list,
    )
    parser.add_argument("scene", metavar="SCENE", help="a name, FILE.toml or FILE.py:FUNCTION")
    parser.add_argument(
        "--out", metavar="DIR", type=output, required=True, help="the study's folder"
    )
    parser.add_argument("--nu", metavar="X,..", help="Poisson's ratios; default: the scene's")
    parser.add_argument(
        "--elements", metavar="E,..", help="elements to compare; default: all that fit the scene"
    )
    parser.add_argument(
        "--cells", metavar="N,..", help="resolutions for every element, from coarse to fine"
    )
    parser.add_argument(
        "--meshes", metavar="FILE,..", help="gmsh files of one body, from coarse to fine"
    )
    for knob, help in _DEFAULTS.items():
        parser.add_argument(f"--{knob}", metavar="X", type=value, help=f"the default: {help}")
    parser.add_argument("--vary", metavar="KNOB,..", help="settings to vary, or none; default: all")
    parser.add_argument(
        "--vary-at", metavar="X,..", help="values of nu at which settings are varied"
    )
    parser.add_argument(
        "--full", action="store_true", help="run every combination of settings on every mesh"
    )
    parser.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[], help="other values of the scene"
    )
    study_options.add_limits(parser, TIMEOUT, MEMORY)
    return parser


def tradeoff(argv: list[str]) -> int:
    """Study a scene; return 0 if there is a recommendation, else 1."""
    parser = tradeoff_parser()
    words, petsc = split_petsc(argv)
    args = parser.parse(words)
    study_options.prepare_process("tradeoff")

    from fem_snh.studies.tradeoff import advice
    from fem_snh.studies.tradeoff.knobs import KNOBS
    from fem_snh.studies.tradeoff.study import tradeoff as study

    if args.cells and args.meshes:
        raise BadInput("--cells and --meshes: expected one of the two")
    vary = [] if args.vary == "none" else _list("vary", args.vary) or list(KNOBS)
    table = study(
        args.scene,
        args.out,
        nus=_numbers("nu", args.nu),
        elements=_list("elements", args.elements),
        meshes=_cells(args.cells) or [str(mesh) for mesh in _list("meshes", args.meshes)],
        base={knob: v for knob in _DEFAULTS if (v := getattr(args, knob)) is not None},
        vary=vary,
        vary_at=_numbers("vary-at", args.vary_at) if args.vary_at is not None else None,
        full=args.full,
        overrides={key: value(word) for key, word in assignments(args.set).items()},
        petsc=petsc,
        **study_options.limits(args),
    )
    for sentence in advice.sentences(table):
        print(sentence)
    print(f"{args.out}: tradeoff.csv, tradeoff.png, advice.csv, advice.md")
    return 0 if len(advice.advice(table)) else 1


def _list(key: str, text: str | None) -> list[Any]:
    return study_options.comma_list(key, text) if text is not None else []


def _numbers(key: str, text: str | None) -> list[float]:
    numbers = _list(key, text)
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
        raise BadInput(f"--{key} {text}: expected numbers with commas between, e.g. 0.3,0.49")
    return [float(number) for number in numbers]


def _cells(text: str | None) -> list[int]:
    cells = _list("cells", text)
    whole = all(isinstance(v, int) and not isinstance(v, bool) and v > 0 for v in cells)
    if not whole or cells != sorted(set(cells)):
        raise BadInput(f"--cells {text}: expected whole numbers from coarse to fine, e.g. 4,8,16")
    return cells
