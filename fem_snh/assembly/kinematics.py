r"""Kinematics: which components a displacement has, and how they become a 3x3 deformation gradient.

The deformation gradient is 3x3 always, so that every energy and every filter of its Hessian serves
all kinematics. With coordinates (x, y) in the plane, (r, z) in a half plane that is revolved,

.. math::

    F_\text{plane} = \begin{pmatrix} 1 + u_{x,x} & u_{x,y} & 0 \\ u_{y,x} & 1 + u_{y,y} & 0 \\
        0 & 0 & 1 \end{pmatrix}, \qquad
    F_\text{revolved} = \begin{pmatrix} 1 + u_{r,r} & u_{r,z} & -u_\theta / r \\
        u_{z,r} & 1 + u_{z,z} & 0 \\ u_{\theta,r} & u_{\theta,z} & 1 + u_r / r \end{pmatrix}

in the basis (e_r, e_z, e_theta) of the reference position. Both are linear in the nodal values. In
plane stress, F_33 at each point is the solution of P_33 = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value, choose

#: The two-dimensional cell that corresponds to each three-dimensional cell.
PLANE_CELLS = {"tetrahedron": "triangle", "hexahedron": "quadrilateral"}


@dataclass(frozen=True)
class Kinematics:
    """How the components of a displacement become a deformation gradient.

    Attributes
    ----------
    name : str
        One of `PLANAR`, or "solid".
    dim : {2, 3}
        Dimension of the mesh.
    components : {2, 3}
        Components of the displacement.
    plane_stress : bool
        Whether F_33 is determined by P_33 = 0.
    revolved : bool
        Whether the body is the mesh revolved about the axis x = 0, in which x is the radius.
    """

    name: str
    dim: int
    components: int
    revolved: bool = False
    plane_stress: bool = False

    @property
    def axes(self) -> tuple[str, ...]:
        """The components' names in scenes; on a body of revolution: radial, axial, rotational."""
        return ("x", "y", "z")[: self.components]

    @property
    def moment_axes(self) -> tuple[str, ...]:
        """The axes about which forces with the displacement's components can have a moment."""
        return tuple(compress("xyz", self.rigid_motions[3:]))

    @property
    def volume_dimension(self) -> int:
        """The exponent of length in a body's volume: 3, or 2 for a volume per thickness."""
        return 3 if self.revolved else self.dim

    @property
    def off_axis(self) -> list[int]:
        """The components that are zero on the axis of a body of revolution, otherwise []."""
        return [i for i in (0, 2) if self.revolved and i < self.components]

    @property
    def rigid_motions(self) -> tuple[bool, ...]:
        """Which rigid motions exist: translations along, then rotations about x, y, z, (6,).

        `fem_snh.geometry.rotations.rigid_displacements` returns them at points in this order.
        """
        if self.revolved:
            return False, True, False, False, self.components == 3, False
        flat = self.dim == 2
        return True, True, not flat, not flat, not flat, True

    @property
    def definitions(self) -> list[str]:
        """The C definitions that kinematics.h reads."""
        kind = "REVOLVED" if self.revolved else "PLANE" if self.dim == 2 else "SOLID"
        kind = "PLANE_STRESS" if self.plane_stress else kind
        return [f"#define COMPONENTS {self.components}", f"#define KINEMATICS {kind}"]

    @property
    def entries(self) -> list[int]:
        """The entries of vec(F) (by columns) that vary, [] if all do (material_point.h)."""
        if self.dim == 3:
            return []
        varied = [i + 3 * j for j in range(2) for i in range(self.components)]
        return varied + [6] * (self.components == 3) + [8] * (self.revolved or self.plane_stress)

    def gradient(self, u: Any, gradient: Any, radius: Any) -> Sequence[Sequence[Any]]:
        """Return the rows of H = F - I, in plane stress those of plane strain.

        Parameters
        ----------
        u : (components,)
            The displacement, of numbers or UFL expressions.
        gradient : (components, dim)
            Its gradient du_i/dX_j.
        radius : number or UFL expression
            The radius r; only a body of revolution needs it.
        """
        rows = [[gradient[i, j] for j in range(self.dim)] for i in range(self.components)]
        if self.dim == 3:
            return rows
        rows += [[0.0 * gradient[0, 0]] * 2 for _ in range(3 - self.components)]
        zero = 0.0 * gradient[0, 0]
        column = [zero] * 3
        if self.revolved:
            column = [-u[2] / radius if self.components == 3 else zero, zero, u[0] / radius]
        return [[*row, last] for row, last in zip(rows, column, strict=True)]

    def padded(self, u: Array) -> Array:
        """Return displacements (components * nodes,) as (nodes, 3), padded with zeros."""
        nodal = u.reshape(-1, self.components)
        if self.components == 3:
            return nodal
        found = np.zeros((len(nodal), 3))  # np.pad takes ten times as long
        found[:, : self.components] = nodal
        return found

    def total(self, vectors: Array) -> Array:
        """Return the sum (3,) of vectors (n, 3); on a body of revolution only the axial part."""
        found: Array = vectors.sum(axis=0)
        return found * (0.0, 1.0, 0.0) if self.revolved else found

    def set_third_tangent(self, T: Array) -> None:
        """Set the last column of T = dx/dxi (..., 3, 3), as third_tangent of kinematics.h does."""
        if self.revolved:
            T[..., 2, 2] = T[..., 0, 2]
            T[..., :2, 2] = 0.0
        elif self.dim == 2:
            T[..., 2, 2] = 1.0

    def set_third_column(self, H: Array) -> None:
        """Replace the last column of H = grad u (..., 3, 3), in place, on a body of revolution.

        On entry it is u over the radius, as the tangent of `set_third_tangent` gives it; afterwards
        it is the derivative along the circumference. `third_column` of kinematics.h does the same.
        """
        if self.revolved:
            radial = H[..., 0, 2].copy()
            H[..., 0, 2] = -H[..., 2, 2]
            H[..., 1, 2], H[..., 2, 2] = 0.0, radial


SOLID = Kinematics("solid", 3, 3)
#: The kinematics of two-dimensional meshes, by name.
PLANAR = {
    kinematics.name: kinematics
    for kinematics in (
        Kinematics("plane_strain", 2, 2),
        Kinematics("plane_stress", 2, 2, plane_stress=True),
        Kinematics("axisymmetric", 2, 2, revolved=True),
        Kinematics("axisymmetric_torsion", 2, 3, revolved=True),
    )
}


def kinematics_of(name: str | None) -> Kinematics:
    """Return the kinematics with this name, one of `PLANAR`; ``SOLID`` for None."""
    return PLANAR[name] if name else SOLID


def find_kinematics(name: str | None, dim: int) -> Kinematics:
    """Return the kinematics of this name on a mesh of this dimension.

    Raises
    ------
    BadInput
        For a name that is unknown, missing in two dimensions, or given in three.
    """
    if dim == 3:
        if name is not None:
            raise bad_value("kinematics", name, "no value: the mesh has 3 dimensions")
        return SOLID
    if name is None:
        listed = ", ".join(PLANAR)
        raise BadInput(
            f"missing key 'kinematics': expected one of {listed}, as the mesh has 2 dimensions"
        )
    return PLANAR[choose("kinematics", name, PLANAR)]
