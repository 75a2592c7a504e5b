"""Rectangles of cells in gmsh's geometry."""

from __future__ import annotations

from typing import Any


def rectangle(geo: Any, low: Any, high: Any, cells: tuple[int, int], triangles: bool) -> Any:
    """Add a rectangle of equal cells; return its lines (bottom, right, top, left) and surface."""
    (a, b), (c, d) = low, high
    corners = [geo.addPoint(x, y, 0) for x, y in ((a, b), (c, b), (c, d), (a, d))]
    lines = [geo.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    for line, count in zip(lines, 2 * cells, strict=True):
        geo.mesh.setTransfiniteCurve(line, count + 1)
    geo.mesh.setTransfiniteSurface(surface)
    if not triangles:
        geo.mesh.setRecombine(2, surface)
    return lines, surface
