"""What an energy is like, asked before an hour is spent on it.

    >>> m = fem_snh.material("stable_neo_hookean", nu=0.49)
    >>> print(m.report())
    >>> m.report().plot("stable_neo_hookean.png")

`curves` (stress against stretch), `drucker` (where the tangent is positive), `stability` (the four
of Smith et al. 2018, measured), `minima` (every shape it may rest in), `collapse` (J -> 0 and
beyond), `table` (all materials). Everything is measured on the kernels that the assembly uses;
only blindness to reflections is asked of the expression, as the kernels have one convention.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fem_snh import materials
from fem_snh.kernels import pointwise

if TYPE_CHECKING:
    from fem_snh.reports.report import Report


class Material(pointwise.Material):
    """A material that can be called, and asked what it is like."""

    def report(self) -> Report:
        """Curves, stabilities, where the tangent is positive, what happens as J -> 0: measured."""
        from fem_snh.reports.report import report  # brings scipy

        return report(self)


def material(name: str, E: float = 1.0, nu: float = 0.49, **shape: Any) -> Material:
    """The material ``name`` normalised to (E [Pa], nu), with its shape parameters as keywords.

    Raises BadInput as `fem_snh.materials.energy` does.
    """
    return Material(materials.energy(name, E, nu, **shape))
