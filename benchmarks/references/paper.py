"""The tables of Smith et al. 2018, by the benchmarks ``twist`` and ``stretch``."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row, stretch, twist
from benchmarks.references.compare import compare

SOURCE = "Smith et al. 2018, section 6"
#: The tolerance of the paper, absolute [E = 1, L = 1]; ours is 1e-7.
LOOSE = 1e-2
#: Length over diameter, cells along the diameter, limit: our cylinder, then one whose proportions
#: are fitted to the volumes of the paper, which does not publish its own.
CYLINDERS = ((1.0, 6, None), (0.45, 8, 10.0))


def paper_twist(cells: int = 15) -> Iterator[Row]:
    """Yield Newton and linear iterations: at most those of the paper, to its tolerance."""
    for tolerance in (LOOSE, 1e-7):
        (found,) = twist.rows(cells=cells, hessians="clamp", tolerance=tolerance)
        for kind in ("newton", "linear"):
            published = sum(twist.PAPER[kind])
            ours = sum(found[kind]) if found["converged"] else None
            what = f"{kind} iterations, twist {cells}^3, clamp, residual {tolerance:g}"
            row = compare(what, SOURCE, published, ours, None, "to the paper's tolerance")
            if tolerance == LOOSE:
                row["ok"] &= ours is not None and ours <= published
            else:
                row["note"] = "to ours"
            yield row


def paper_stretch() -> Iterator[Row]:
    """Yield volumes at 3.4 times the length, of our cylinder and of one of fitted proportions."""
    for aspect, cells, limit in CYLINDERS:
        for found in stretch.rows(elements="P2", cells=cells, aspect=aspect):
            ours = found["volume_percent"] if found["converged"] else None
            published = found["paper_volume_percent"]
            what = f"volume [%], stretch 3.4, {found['material']}, length {aspect:g} diameters"
            note = "" if limit else "the paper's proportions are not published"
            yield compare(what, SOURCE, published, ours, limit, note)
