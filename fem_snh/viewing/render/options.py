"""What pictures and pages show of a body, from which side: clip plane, camera, hidden parts."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from fem_snh.errors import bad_value

Point = tuple[float, float, float]

#: Names of directions.
_DIRECTIONS = {
    "x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip


@dataclass(frozen=True)
class ViewOptions:
    """What is shown, and from which side.

    Attributes
    ----------
    clip : (3,), optional
        Normal of a plane: the part of the deformed body that it points to is cut away, and the
        section has the colours of the field.
    clip_point : (3,), optional
        A point of the plane [m]; default: the centre of the body at rest.
    camera : (3,), optional
        Direction from the body to the viewer.
    focus : (3,), optional
        The point at the centre of the picture [m].
    up : (3,), optional
        Direction that is upwards in the picture; default: z, or y for a viewer above or below.
    zoom : float
        Magnification: 1 shows the whole body.
    hide : tuple of str
        Names of obstacles, bones, groups of cells and materials that are not drawn.
    hidden_cells : tuple of int
        Values of the field ``cell_group`` in cells that are not drawn.
    limits : (2,), optional
        The values at the ends of the colour bar; default: of all values but the outer percents.
    """

    clip: Point | None = None
    clip_point: Point | None = None
    camera: Point | None = None
    focus: Point | None = None
    up: Point | None = None
    zoom: float = 1.0
    hide: tuple[str, ...] = ()
    hidden_cells: tuple[int, ...] = ()
    limits: tuple[float, float] | None = None


#: The whole body from the default side.
WHOLE = ViewOptions()


def view_options(
    clip: str | None = None,
    camera: str | None = None,
    up: str | None = None,
    zoom: float = 1.0,
    hide: Iterable[str] = (),
    limits: str | None = None,
) -> ViewOptions:
    """Return the options that the texts of a command line name.

    Parameters
    ----------
    clip : str, optional
        Normal and, after "@", a point of a plane: ``x``, ``-y``, ``0,0,1@0,0,0.2``. A number
        after "@" is the plane's distance from the origin along the normal.
    camera : str, optional
        Direction and, after "@", the focus: ``x``, ``1,-1,0.5@0,0,1``.
    up : str, optional
        A direction.
    zoom : float
        Magnification.
    hide : iterable of str
        Names of obstacles, bones, groups of cells and materials.
    limits : str, optional
        The values at the ends of the colour bar, ``0,2.5``.

    Raises
    ------
    BadInput
        If a text is no direction, point or range, or ``zoom`` is not positive.
    """
    if not 0 < zoom < math.inf:
        raise bad_value("--zoom", zoom, "a number above 0")
    normal, point = _direction_and_point("--clip", clip)
    towards, focus = _direction_and_point("--camera", camera)
    upwards, nowhere = _direction_and_point("--up", up)
    if nowhere is not None:
        raise bad_value("--up", up, "a direction: x, -z or three numbers")
    seen_along = towards or (0.62, -1.0, 0.55)
    if upwards and not math.dist((0, 0, 0), _cross(upwards, seen_along)) > 1e-6:
        raise bad_value("--up", up, "a direction other than that of --camera")
    ends = None
    if limits is not None:
        found = _numbers(limits)
        if not (len(found) == 2 and -math.inf < found[0] < found[1] < math.inf):
            raise bad_value("--range", limits, "two numbers, the smaller one first: 0,2.5")
        ends = found[0], found[1]
    return ViewOptions(normal, point, towards, focus, upwards, zoom, tuple(hide), limits=ends)


def _direction_and_point(option: str, text: str | None) -> tuple[Point | None, Point | None]:
    """Return the unit vector and the point of ``0,0,1@0,0,0.2``."""
    if text is None:
        return None, None
    accepted = "a direction, x, -y or 0,0,1, and perhaps a point of it: x@0.2 or 0,0,1@0,0,0.2"
    before, at, after = text.partition("@")
    direction = _DIRECTIONS.get(before.strip()) or _numbers(before)
    point = _numbers(after) if at else []
    length = math.hypot(*direction)
    if len(direction) != 3 or not 0 < length < math.inf or (at and len(point) not in (1, 3)):
        raise bad_value(option, text, accepted)
    unit = (direction[0] / length, direction[1] / length, direction[2] / length)
    if not at:
        return unit, None
    place = point if len(point) == 3 else [point[0] * n for n in unit]
    if not all(map(math.isfinite, place)):
        raise bad_value(option, text, accepted)
    return unit, (place[0], place[1], place[2])


def _numbers(text: str) -> list[float]:
    """Return the numbers of a list with commas; none if one is not a number."""
    try:
        return [float(entry) for entry in text.split(",")]
    except ValueError:
        return []


def _cross(a: Point, b: Point) -> Point:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
