"""The commands ``plot``, ``render``, ``view`` and ``export``."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from fem_snh.cli import start_petsc
from fem_snh.cli.options import Parser, output, value
from fem_snh.errors import BadInput
from fem_snh.files import is_shape
from fem_snh.viewing import reading
from fem_snh.viewing.export import main as export_run
from fem_snh.viewing.render import main as draw_run
from fem_snh.viewing.render import movie, page
from fem_snh.viewing.stored_run import ViewOptions, view_options

#: Options of ``render`` and ``view``.
_VIEW = """--clip NORMAL[@POINT]  cut the deformed body by a plane and remove the side that
            the normal points to: x, 0,0,1@0,0,0.2, or x@0.2, the plane x = 0.2; default: through
            the centre; write --clip=-y if it begins with a minus
        --camera DIRECTION[@FOCUS]  direction to the viewer: x, -y or 1,-1,0.5@0,0,1
        --zoom A  magnification; default: 1
        --hide NAME,NAME  obstacles, bones, groups of cells and materials that are not drawn
        --range LOW,HIGH  values at the ends of the colour bar; default: of all values but the
            outer percents; write --range=-1,2 if it begins with a minus"""


def plot_parser() -> Parser:
    """Return the parser of ``fem-snh plot``."""
    return Parser(
        "plot",
        "Draw curves from run folders (one line each) or from a study's table.",
        """
        paths DIR|TABLE.csv  what to draw
        --out PNG  file of the picture
        --newton  also draw the Newton iterations
        --x COLUMN  what the curves of --y are over: a column of steps.csv or of the table, e.g.
            corner.y, nu; default: the load, or what the scene calls it, as angle
        --y COLUMN,COLUMN  columns to draw, e.g. top.force.z,inner.moment.z; A/B is a quotient
        --columns  print the columns of runs, their last values and units instead
        """,
        paths={"nargs": "+", "type": Path},
        out=output,
    )


@reading()
def plot(argv: list[str]) -> int:
    """Draw curves from run folders or a study's table; return 0."""
    args = plot_parser().parse(argv)

    if args.columns:
        from fem_snh.viewing.plots.runs import list_columns

        print("\n".join(line for path in args.paths for line in list_columns(path)))
        return 0

    from fem_snh.viewing.plots import main

    columns = [name.strip() for name in args.y.split(",")] if args.y is not None else []
    print(main(args.paths, args.out, args.newton, args.x, columns))
    return 0


def render_parser() -> Parser:
    """Return the parser of ``fem-snh render``."""
    return Parser(
        "render",
        "Draw the deformed body of a run folder, one panel per load.",
        """
        folder DIR  folder of a run
        --out PNG  file of the picture
        --loads T,T  loads to draw, between 0 and 1, e.g. 0.5,1; times [s] of a run in time
        --modes N,N  draw eigenmodes: these numbers, or all
        --field NAME  field of the run that the colours show, or a component: cauchy_stress.xy;
            default: J
        --opacity A  opacity of the body, e.g. 0.4 to show its bones; default: 1
        {_VIEW}
        --movie FILE  draw a movie instead: a file .mp4 or .gif
        --seconds S  length of the movie; default: 4
        """.replace("{_VIEW}", _VIEW),
        folder=Path,
        out=output,
        modes={"nargs": "?", "const": ""},
        field={"default": "J"},
        opacity={"type": float, "default": 1.0},
        movie=output,
        seconds={"type": float, "default": 4.0},
        zoom={"type": float, "default": 1.0},
    )


@reading()
def render(argv: list[str]) -> int:
    """Draw the deformed body of a run folder; return 0."""
    args = render_parser().parse(argv)
    if args.modes is not None and args.loads is not None:
        raise BadInput("--loads and --modes: expected one of the two")
    if args.movie is not None:
        return _movie(args)
    modal = args.modes is not None
    if modal:
        accepted = "mode numbers from 1 on, e.g. 1,2,3"
        pictured = _numbers("--modes", args.modes or None, accepted, (int,))
    else:
        pictured = _numbers("--loads", args.loads, "numbers, e.g. 0.5,1", (int, float))

    look = (args.field, modal, args.opacity, _view(args))
    print(draw_run(args.folder, args.out, pictured, *look, print))
    return 0


def _view(args: Namespace) -> ViewOptions:
    """Return the options of clip plane, camera, zoom, hidden parts and colour range."""
    hide = [name.strip() for name in (args.hide or "").split(",") if name.strip()]
    return view_options(args.clip, args.camera, args.zoom, hide, args.range)


def _movie(args: Namespace) -> int:
    """Draw the movie that the options request, with a progress bar; return 0."""
    for name in ("out", "loads", "modes"):
        if vars(args)[name] is not None:
            raise BadInput(f"--{name} and --movie: expected one of the two")

    with _progress_bar("drawing") as report:
        path = movie(
            args.folder, args.movie, args.field, args.seconds, report, args.opacity, _view(args)
        )
    print(path)
    return 0


def view_parser() -> Parser:
    """Return the parser of ``fem-snh view``."""
    return Parser(
        "view",
        "Write a run as one HTML page that needs no other file and no network: the body in three "
        "dimensions, curves, steps, settings and versions.",
        """
        folder DIR  folder of a run
        --out HTML  the page; default: DIR/view.html
        --field NAME  field that the colours show; default: J
        {_VIEW}
        """.replace("{_VIEW}", _VIEW),
        folder=Path,
        out=output,
        field={"default": "J"},
        zoom={"type": float, "default": 1.0},
    )


@reading()
def view(argv: list[str]) -> int:
    """Write the HTML page of a run folder; return 0."""
    args = view_parser().parse(argv)

    print(page(args.folder, args.out, args.field, _view(args)))
    return 0


def export_parser() -> Parser:
    """Return the parser of ``fem-snh export``."""
    return Parser(
        "export",
        "Write all stored loads of a run into one VTKHDF file for ParaView, with the load as time, "
        "or the deformed surface as a sequence of OBJ files; or a gmsh file, "
        "or the mesh of an .xao file, as an XDMF file, of which every rank reads its part.",
        """
        folder DIR|MSH  folder of a run; or a gmsh or .xao file, for NAME.xdmf
        out OUT  NAME.vtkhdf: one file; NAME.obj: files NAME_0000.obj, NAME_0001.obj, ...
        """,
        folder=Path,
        out=output,
    )


def export(argv: list[str]) -> int:
    """Write a run's states in another format, with a progress bar. Return 0."""
    args = export_parser().parse(argv)
    if args.folder.suffix == ".msh" or is_shape(args.folder):
        return _convert_mesh(args)

    with reading(), _progress_bar("writing") as report:
        paths = export_run(args.folder, args.out, report)
    print(paths[0] if len(paths) == 1 else f"{paths[0]} ... {paths[-1].name}")
    return 0


def _convert_mesh(args: Namespace) -> int:
    """Write a gmsh file as an XDMF file; return 0. Collective."""
    from mpi4py import MPI

    start_petsc()
    from fem_snh.mesh import mesh

    if Path(args.out).suffix != mesh.XDMF:
        raise BadInput(f"OUT = {args.out}: expected a file {mesh.XDMF} for a mesh")
    mesh.write_xdmf(mesh.read(MPI.COMM_WORLD, args.folder), args.out)
    if MPI.COMM_WORLD.rank == 0:
        print(args.out)
    return 0


def _numbers(option: str, text: str | None, accepted: str, kinds: tuple[type, ...]) -> list | None:
    """Return the numbers, of these types, of a comma-separated text; None for None."""
    if text is None:
        return None
    numbers = [value(word) for word in text.split(",")]
    if not all(isinstance(number, kinds) and not isinstance(number, bool) for number in numbers):
        raise BadInput(f"{option} {text}: expected {accepted}")
    return numbers


@contextmanager
def _progress_bar(description: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on a terminal's standard error for the duration of a ``with`` block.

    Yields a function (done, total) that shows the numbers of finished items and of all items.
    """
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(description)
        yield lambda done, total: bar.update(task, completed=done, total=total)
