"""The commands ``plot``, ``render``, ``view`` and ``doctor``."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fem_snh.cli.options import Parser, output, value
from fem_snh.cli.progress_bar import progress_bar
from fem_snh.errors import BadInput


def plot_parser() -> Parser:
    """Return the parser of ``fem-snh plot``."""
    parser = Parser("plot", "Draw curves from run folders (one line each) or from a study's table.")
    parser.add_argument("paths", metavar="DIR|TABLE.csv", nargs="+", type=Path, help="what to draw")
    parser.add_argument("--out", metavar="PNG", type=output, help="file of the picture")
    parser.add_argument("--newton", action="store_true", help="also draw the Newton iterations")
    return parser


def plot(argv: list[str]) -> int:
    """Draw curves from run folders or a study's table; return 0."""
    parser = plot_parser()
    args = parser.parse(argv)

    from fem_snh.viewing.plots import main

    print(main(args.paths, args.out, args.newton))
    return 0


def render_parser() -> Parser:
    """Return the parser of ``fem-snh render``."""
    parser = Parser("render", "Draw the deformed body of a run folder, one panel per load.")
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of a run")
    parser.add_argument("--out", metavar="PNG", type=output, help="file of the picture")
    parser.add_argument(
        "--loads",
        metavar="T,T",
        help="loads to draw, between 0 and 1, e.g. 0.5,1; times [s] of a run in time",
    )
    parser.add_argument(
        "--modes", metavar="N,N", nargs="?", const="", help="draw eigenmodes: these numbers, or all"
    )
    parser.add_argument(
        "--field",
        metavar="NAME",
        default="J",
        help="field of the run that the colours show, or a component: cauchy_stress.xy; default: J",
    )
    parser.add_argument(
        "--opacity",
        metavar="A",
        type=float,
        default=1.0,
        help="opacity of the body, e.g. 0.4 to show its bones; default: 1",
    )
    parser.add_argument(
        "--movie", metavar="FILE", type=output, help="draw a movie instead: a file .mp4 or .gif"
    )
    parser.add_argument(
        "--seconds", metavar="S", type=float, default=4.0, help="length of the movie; default: 4"
    )
    return parser


def render(argv: list[str]) -> int:
    """Draw the deformed body of a run folder; return 0."""
    parser = render_parser()
    args = parser.parse(argv)
    if args.modes is not None and args.loads is not None:
        raise BadInput("--loads and --modes: expected one of the two")
    if args.movie is not None:
        return _movie(args)
    loads = _numbers("--loads", args.loads, "numbers, e.g. 0.5,1", (int, float))
    modes = _numbers("--modes", args.modes or None, "mode numbers from 1 on, e.g. 1,2,3", (int,))

    from fem_snh.viewing.render import main

    pictured = loads if args.modes is None else modes
    modal = args.modes is not None
    print(main(args.folder, args.out, pictured, args.field, modal, args.opacity))
    return 0


def _movie(args: Namespace) -> int:
    """Draw the movie that the options request, with a progress bar; return 0."""
    for option, given in (("--out", args.out), ("--loads", args.loads), ("--modes", args.modes)):
        if given is not None:
            raise BadInput(f"{option} and --movie: expected one of the two")

    from fem_snh.viewing.render.movie import main

    with progress_bar("drawing") as report:
        path = main(args.folder, args.movie, args.field, args.seconds, report, args.opacity)
    print(path)
    return 0


def view_parser() -> Parser:
    """Return the parser of ``fem-snh view``."""
    parser = Parser(
        "view",
        "Write a run as one HTML page that needs no other file and no network: the body in three "
        "dimensions, curves, steps, settings and versions.",
    )
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of a run")
    parser.add_argument(
        "--out", metavar="HTML", type=output, help="the page; default: DIR/view.html"
    )
    parser.add_argument(
        "--field", metavar="NAME", default="J", help="field that the colours show; default: J"
    )
    return parser


def view(argv: list[str]) -> int:
    """Write the HTML page of a run folder; return 0."""
    args = view_parser().parse(argv)

    from fem_snh.viewing.view import main

    print(main(args.folder, args.out, args.field))
    return 0


def _numbers(option: str, text: str | None, accepted: str, kinds: tuple[type, ...]) -> list | None:
    """Return the numbers of a comma list, or None if there is no list."""
    if text is None:
        return None
    numbers = [value(word) for word in text.split(",")]
    if not all(isinstance(number, kinds) and not isinstance(number, bool) for number in numbers):
        raise BadInput(f"{option} {text}: expected {accepted}")
    return numbers


def doctor_parser() -> Parser:
    """Return the parser of ``fem-snh doctor``."""
    return Parser("doctor", "Check the installation: versions, MPI, BLAS, compiler, cache folder.")


def doctor(argv: list[str]) -> int:
    """Check the installation; return 0 if it is complete, 2 if something is missing."""
    doctor_parser().parse(argv)

    from fem_snh.cli.doctor import main

    return main() or 0
