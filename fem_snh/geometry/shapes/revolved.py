"""A shape of two dimensions revolved about an axis: an obstacle of a body under torsion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_snh.geometry.shapes.shape import Array, Evaluation, Shape, inverse


@dataclass(frozen=True)
class Revolved:
    r"""The solid of revolution about the axis y of a section in the half plane z = 0, x >= 0.

    With :math:`r = \sqrt{x^2 + z^2}` its distance is that of the section at (r, y, 0).

    Parameters
    ----------
    section : Shape
        The section.
    """

    section: Shape

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        (_, low, _), (radius, high, _) = self.section.bounds
        return np.array([[-radius, low, -radius], [radius, high, radius]])

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        return self.section.distance(_in_half_plane(x))

    def evaluate(self, x: Array) -> Evaluation:
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""
        at = _in_half_plane(x)
        found = self.section.evaluate(at)
        radial = np.where(at[:, [0]] > 0, x * inverse(at[:, 0])[:, None], [1.0, 0.0, 0.0])
        radial[:, 1] = 0.0
        turn = np.cross(radial, [0.0, 1.0, 0.0])
        #: The directions e_r, e_y, e_theta as rows.
        frame = np.stack([radial, np.broadcast_to([0.0, 1.0, 0.0], x.shape), turn], axis=1)
        hessian = found.hessian.copy()
        hessian[:, 2, 2] = found.gradient[:, 0] * inverse(at[:, 0])
        return Evaluation(
            found.distance,
            np.einsum("nai,na->ni", frame, found.gradient),
            np.einsum("nai,nab,nbj->nij", frame, hessian, frame),
        )


def _in_half_plane(x: Array) -> Array:
    """Return points x (n, 3) turned about the axis into the half plane z = 0."""
    return np.column_stack([np.hypot(x[:, 0], x[:, 2]), x[:, 1], 0 * x[:, 2]])
