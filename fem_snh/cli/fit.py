"""The command ``fit``: fit a material to test data, or rank all materials."""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from fem_snh.cli import start_petsc
from fem_snh.cli.materials import print_table
from fem_snh.cli.options import (
    REPEATED,
    Parser,
    assignments,
    material_values,
    output,
    split_petsc,
    value,
    values_of,
    with_settings,
)
from fem_snh.cli.run import comma_list, load_scene
from fem_snh.errors import BadInput, check_number, check_whole, on_root
from fem_snh.records.units import Units
from fem_snh.studies.fit import Fit, ordered, rank, write_ranking
from fem_snh.studies.fit import fit as fit_material

if TYPE_CHECKING:
    from fem_snh.runs.inverse import SceneFit

EPILOG = """\
fem-snh fit ogden treloar                          Treloar's rubber, which is built in
fem-snh fit yeoh pull.csv squeeze.csv              two tests at once
fem-snh fit stable_neo_hookean pull.csv --nu 0.45  compressible; --parameters alpha fits it too
fem-snh fit --all jones_treloar                    rank all materials; biaxial tests, built in
fem-snh fit press.toml --to curve.csv --parameters E,nu   fit a scene to a measured curve

The curve has a column load, from 0 to 1, or the scene's load_name, and columns with the names of
goals, e.g. right.force.x. It works under mpirun too.

A file of test data has columns with names, and a line with the test:
  # test = uniaxial          or equibiaxial, planar, biaxial, simple_shear, volumetric, confined
  stretch, stress [MPa]      or strain, shear, volume_ratio; pressure
A test = biaxial has a column stretch_2, and stress, stress_2 or stress_difference (true stresses).
"""
#: Materials that the picture of a ranking shows.
_SHOWN = 5


def fit_parser() -> Parser:
    """Return the parser of ``fem-snh fit``."""
    return Parser(
        "fit",
        "Fit E and the shape parameters of a material to test data by bounded least squares, and\n"
        "write fit.json, fit.png and the table [material] of a scene.",
        """
        names NAME  a material or FILE.py:FUNCTION, then files of test data; with --all only files;
            with --to a scene
        --all  fit all materials and rank them
        --to FILE  measured curve to which parameters of the scene are fitted
        --solves N  largest number of solves of the scene; default: 12
        --nu X  Poisson's ratio; 0.5 is J = 1, the default; with volumetric or confined tests nu
            is fitted by default
        --parameters NAME,..  shape parameters to fit; default: all that are numbers
        --set KEY=VALUE  hold a shape parameter at a value
        --bounds KEY=LOW,HIGH  bounds of a parameter
        --relative  minimise differences relative to the measured stresses
        --weights W,..  weight of each file
        --test KIND,..  kind of each file's test
        --columns NAME,..  names of the columns; those with other names are not used
        --unit UNIT  unit of the stresses: MPa, psi, ...
        --modulus-unit UNIT  unit of E and of the constants, e.g. MPa for a scene in mm; default:
            Pa, or that of the stresses if none is stated
        --range LOW,HIGH  stretches between which stability is evaluated
        --out DIR  folder of fit.json, fit.png and material.toml; default: out/fit
        """,
        lambda: EPILOG,
        names={"nargs": "*"},
        set=REPEATED,
        bounds=REPEATED,
        nu=value,
        solves={"type": value, "default": 12},
        out={"type": output, "default": Path("out/fit")},
    )


def fit(argv: list[str]) -> int:
    """Fit a material, rank all of them, or fit a scene; return 0, or 1 without convergence."""
    words, petsc = split_petsc(argv)
    args = fit_parser().parse(words)
    if args.to is not None:
        return _fit_scene(args, petsc)
    if petsc:
        raise BadInput("fit: PETSc options: expected with a scene and --to")
    given = vars(args)
    keywords = {key: given[key] for key in ("nu", "relative", "unit", "modulus_unit")}
    keywords["stable_range"] = None if args.range is None else _pair("range", args.range)
    bounds = assignments(args.bounds).items()
    keywords["bounds"] = {key: _pair(f"bounds {key}", text) for key, text in bounds}
    for key in ("parameters", "test", "columns", "weights"):
        keywords[key] = None if given[key] is None else comma_list(key, given[key])
    keywords["held"] = material_values(args.set)
    if args.all:
        return _rank(args, keywords)
    if not args.names:
        raise BadInput("fit: missing NAME: expected a material and files of test data, or --all")
    found = fit_material(*args.names, **keywords)
    _print(found)
    _write(found, args.out)
    return 0


def _fit_scene(args: Namespace, petsc: dict[str, str | None]) -> int:
    """Fit parameters of a scene to a measured curve; return 0 if the search converged, else 1."""
    from mpi4py import MPI

    start_petsc()
    from fem_snh.runs.inverse import fit_scene

    accepted = ("names", "to", "parameters", "solves", "nu", "set", "out")
    unused = vars(fit_parser().parse([]))
    if any(given != unused[key] for key, given in vars(args).items() if key not in accepted):
        raise BadInput(
            "fit --to: expected with --parameters, --solves, --nu, --set and --out alone"
        )
    if len(args.names) != 1 or not args.parameters:
        raise BadInput("fit --to: expected one scene and --parameters NAME,..")
    check_whole("solves", args.solves, 1, 10**6)
    overrides = with_settings({"nu": args.nu}, values_of(args.set))
    comm = MPI.COMM_WORLD
    with Console(stderr=True, quiet=comm.rank > 0).status("fitting"):
        scene = load_scene(comm, args.names[0], overrides, petsc)
        parameters = comma_list("parameters", args.parameters)
        found = fit_scene(scene, args.to, parameters, comm=comm, max_solves=args.solves)

    def report() -> None:
        points = sum(map(math.isfinite, found.curve.values.ravel()))
        unit = Units.read(scene.units).stress if scene.units else ""
        units = {name: unit if name == "E" else "" for name in found.parameters}
        _print_parameters(found.parameters, found.errors, units, points)
        counts = np.isfinite(found.curve.values).sum(axis=0)
        rows = [
            (name, str(count), f"{found.rms[name]:.4g}", f"{found.r_squared[name]:.5f}")
            for name, count in zip(found.curve.names, counts, strict=True)
        ]
        print_table(("goal", "points", "rms", "R²"), rows)
        print(f"{found.solves} solves, {'converged' if found.converged else 'not converged'}\n")
        print(found.table())
        _write(found, args.out)

    on_root(comm, report)
    return 0 if found.converged else 1


def _write(found: Fit | SceneFit, out: Path) -> None:
    """Write the files of a fit to a folder."""
    found.write(out / "fit.json")
    found.write_table(out / "material.toml")
    found.plot(out / "fit.png")
    print(f"{out}: fit.json, fit.png, material.toml")


def _rank(args: Namespace, keywords: dict[str, Any]) -> int:
    """Fit all materials, print them from the best to the worst, and write the files; return 0."""
    fits: list[Fit] = []
    refused: list[tuple[str, str]] = []
    with Console(stderr=True).status("fitting") as status:
        for found in rank(*args.names, **keywords):
            if isinstance(found, Fit):
                fits.append(found)
                status.update(f"fitting: {found.name}")
            else:
                refused.append(found)
    if not fits:
        raise BadInput(f"fit --all: no material can be fitted: {refused[0][1]}")
    fits = ordered(fits)
    heading = ("", "material", "parameters", "R²", "rms", "AICc", "stable at the data")
    rows = [
        (str(place), f.name, str(len(f.parameters)), f"{f.r_squared:.5f}", f"{f.rms:.4g}",
         f"{f.aicc:.1f}", "yes" if f.stable_at_data else "no")
        for place, f in enumerate(fits, start=1)
    ]  # fmt: skip
    print_table(heading, rows)
    for name, reason in refused:
        print(f"not fitted: {reason if name in reason else f'{name}: {reason}'}")
    best = fits[0]
    _print_notes(best)
    best.write(args.out / "fit.json")
    best.write_table(args.out / "material.toml")
    write_ranking(fits, args.out / "ranking.csv")
    from fem_snh.viewing.plots.materials import draw_fits

    draw_fits(fits[:_SHOWN], args.out / "fit.png")
    print(f"{args.out}: ranking.csv, fit.png; of {best.name}: fit.json, material.toml")
    return 0


def _print(found: Fit) -> None:
    """Print parameters, tests, stable ranges and the table of a scene."""
    points = sum(len(t.data.x) for t in found.tests)
    _print_parameters(found.parameters, found.errors, found.units, points)
    rows = [
        (t.data.name, t.data.kind, str(len(t.data.x)), f"{t.rms:.4g}", f"{t.largest:.4g}",
         f"{t.r_squared:.5f}")
        for t in found.tests
    ]  # fmt: skip
    print_table(("test", "kind", "points", "rms", "largest", "R²"), rows)
    low, high = found.searched
    for s in found.stable:
        words = "all of it" if s.whole else f"{s.low:.4g} to {s.high:.4g}"
        print(f"stable (Drucker) between stretches {low:.3g} and {high:.3g}, {s.kind}: {words}")
    if any(t.data.kind == "biaxial" for t in found.tests):
        print(f"stable (Drucker) at all data: {'yes' if found.stable_at_data else 'no'}")
    _print_notes(found)
    print()
    print(found.table())


def _print_notes(found: Fit) -> None:
    """Print the notes on doubtful data."""
    for line in found.notes:
        print(f"note: {line}")


def _print_parameters(
    values: Mapping[str, float], errors: Mapping[str, float], units: Mapping[str, str], points: int
) -> None:
    """Print the parameters of a fit to this number of points, with their standard errors."""
    rows = [
        (name, f"{number:.6g}", _error(errors[name], points > len(values)), units[name])
        for name, number in values.items()
    ]
    print_table(("parameter", "value", "standard error", "unit"), rows)


def _error(error: float, over_determined: bool) -> str:
    """Return a standard error, or the reason why there is none, as text."""
    if math.isnan(error):
        return "at its bound"
    if not over_determined:
        return "needs more points than parameters"
    return f"{error:.2g}" if math.isfinite(error) else "not shown by the data"


def _pair(key: str, text: str) -> tuple[float, float]:
    """Return the two numbers of a text with a comma between, or raise BadInput."""
    found = comma_list(key, text)
    if len(found) != 2 or not all(type(x) in (int, float) for x in found):
        raise BadInput(f"--{key} {text}: expected two numbers with a comma between, e.g. 0.5,2")
    for number in found:
        check_number(key, number, -math.inf)
    return float(found[0]), float(found[1])
