"""The small commands: plot, render, doctor."""

from __future__ import annotations

from pathlib import Path

from fem_snh.cli.options import Parser, value
from fem_snh.errors import BadInput


def plot(argv: list[str]) -> int:
    """Curves from run folders or a study's table."""
    parser = Parser("plot", "Curves from run folders (one line each) or from a study's table.")
    parser.add_argument("paths", metavar="DIR|TABLE.csv", nargs="+", type=Path)
    parser.add_argument("--out", metavar="PNG", type=Path)
    parser.add_argument("--newton", action="store_true", help="Newton iterations as well")
    args = parser.parse(argv)

    from fem_snh.plots import main

    print(main(args.paths, args.out, args.newton))
    return 0


def render(argv: list[str]) -> int:
    """A picture of the deformed body of a run folder."""
    parser = Parser("render", "Draw the deformed body of a run folder, one panel per load.")
    parser.add_argument("folder", metavar="DIR", type=Path)
    parser.add_argument("--out", metavar="PNG", type=Path)
    parser.add_argument("--loads", metavar="T,T", help="loads between 0 and 1, e.g. 0.5,1")
    parser.add_argument(
        "--modes", metavar="N,N", nargs="?", const="", help="eigenmodes (all, or these numbers)"
    )
    parser.add_argument("--field", metavar="NAME", default="J", help="the colour (default: J)")
    args = parser.parse(argv)
    if args.modes is not None and args.loads is not None:
        raise BadInput("--loads and --modes: a picture is of one of them")
    loads = _numbers("--loads", args.loads, "numbers between 0 and 1, e.g. 0.5,1", (int, float))
    modes = _numbers("--modes", args.modes, "mode numbers from 1 on, e.g. 1,2,3", (int,))

    from fem_snh.render import main

    pictured = loads if args.modes is None else modes
    print(main(args.folder, args.out, pictured, args.field, modes=args.modes is not None))
    return 0


def _numbers(option: str, text: str | None, accepted: str, kinds: tuple[type, ...]) -> list | None:
    """A comma list of numbers, or None where there is none."""
    if not text:
        return None
    found = [value(word) for word in text.split(",")]
    if not all(isinstance(number, kinds) and not isinstance(number, bool) for number in found):
        raise BadInput(f"{option} {text}: expected {accepted}")
    return found


def doctor(argv: list[str]) -> int:
    """Say whether this machine has what it takes."""
    Parser("doctor", "Say whether this machine has what it takes.").parse(argv)

    from fem_snh.doctor import main

    return main() or 0
