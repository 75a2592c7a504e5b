"""Terms that replace the displacements of some nodes by fewer unknowns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.assembled_matrix import BlockMatrix

if TYPE_CHECKING:
    from fem_snh.assembly.nodal_mass import NodalMass  # it imports scipy
    from fem_snh.geometry.shapes import Shape

Array = npt.NDArray[np.float64]


@runtime_checkable
class EliminatingTerm(Protocol):
    """A term whose nodes follow a few unknowns: `fem_snh.terms.rigid_parts.RigidParts`.

    The problem's vector x keeps all displacements; gradients and steps have the unknowns at some
    of these entries, and zeros at the others. All methods are collective.

    Attributes
    ----------
    cells : (n,) int
        This rank's own cells that do not deform: they are not assembled.
    nodes : (n,) int
        This rank's own nodes that follow the unknowns.
    dofs : (n, components) int
        Their displacement dofs.
    labels : (n,) int
        The part of each of them.
    shapes : dict of Shape
        The shapes of the parts that are shapes, by the part's number.
    names : list of str
        The parts' names.
    """

    cells: npt.NDArray[Any]
    nodes: npt.NDArray[Any]
    dofs: npt.NDArray[Any]
    labels: npt.NDArray[Any]
    shapes: dict[int, Shape]
    names: list[str]

    @property
    def number(self) -> int:
        """The number of parts."""

    def constraint_rows(self, owners: Array, origin: Array, length: float, size: int) -> Array:
        """Return what is constrained of rigid motions of the body."""

    def spring_rows(
        self, owners: Array, origin: Array, length: float, size: int, modulus: float
    ) -> Array:
        """Return rows whose squares are the springs' stiffness along rigid motions."""

    def load_work(self, owners: Array, origin: Array, length: float, mode: Array) -> Array:
        """Return minus the work of loads along a rigid motion, (parts,)."""

    def fold(self, matrix: BlockMatrix) -> npt.NDArray[Any]:
        """Fold a problem's matrix from now on; return the entries that are no unknowns."""

    def prepare(self, x: PETSc.Vec, gradient: PETSc.Vec, filter: str, whole: bool = False) -> None:
        """Set the fold at x, where the derivative by all displacements is ``gradient``.

        With the ``whole`` of an exact Hessian that is not symmetric: see `Problem.jacobian`.
        """

    def reduce(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Replace the derivative by displacements by that by the unknowns, with the term's own."""

    def reduce_vector(self, x: PETSc.Vec, g: PETSc.Vec) -> None:
        """Replace the derivative of another quantity by displacements by that by the unknowns."""

    def poses(self, x: PETSc.Vec) -> Any:
        """Return the poses that are nearest to the displacements in ``x``."""

    def pose(self, x: PETSc.Vec, number: int) -> npt.NDArray[Any]:
        """Return the matrix [A | c], (3, 4), of a part's motion x = A X + c."""

    def place_nodes(self, x: PETSc.Vec, number: int, points: npt.NDArray[Any]) -> None:
        """Let a part's nodes be at other points of it, (n, 3), and move them there in ``x``."""

    def prescribe(self, x: PETSc.Vec, load: float, poses: Any = None) -> None:
        """Set the nodes to the displacements nearest to given poses that a load admits."""

    def move(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set the nodes in ``end`` to the end of their path from x along step d."""

    def move_rigidly(self, x: PETSc.Vec) -> None:
        """Set the nodes to the nearest displacements that are admissible at the present load."""

    def force_norms(self, x: PETSc.Vec) -> tuple[float, float, float]:
        """Return the norms on the unknowns of loads, of drives and of springs [N]."""

    @property
    def moves(self) -> bool:
        """Whether motions are prescribed."""

    @property
    def prescribed_parts(self) -> Array:
        """The numbers of the parts whose motion is prescribed as a whole."""

    def prescribed_displacement(self, load: float) -> Array:
        """Return the displacements at a load of this rank's own nodes of these parts, (n,)."""

    def prepare_mass(self, x: PETSc.Vec) -> None:
        """Set the fold of a mass matrix at x."""

    def derivative(self, x: PETSc.Vec) -> tuple[npt.NDArray[Any], Array]:
        """Return global entries of unknowns, and the derivative of ``dofs`` by them, (n, k)."""

    def expand(self, x: PETSc.Vec, values: Array) -> None:
        """Replace unknowns at their entries of (owned dofs,) by displacements of the nodes."""

    def place(self, part: str) -> Array:
        """Return the reference coordinates of a part's point, (3,)."""

    def velocity(self, x: PETSc.Vec, part: str, twist: Array) -> PETSc.Vec:
        """Return the velocities of the part's nodes in a twist (6,)."""

    def derivative_of_pose(self, x: PETSc.Vec, part: str, kind: str, component: int) -> PETSc.Vec:
        """Return the derivative of a "displacement" or a "rotation" by those of the part's nodes.

        Only its products with rigid motions are determined: it is one of many that share them.
        """

    def derivative_of_arms(
        self, x: PETSc.Vec, part: str, gradient: PETSc.Vec, axis: int
    ) -> PETSc.Vec:
        """Return the derivative of the moment about the point of forces of constant direction."""

    def make_rigid(
        self, x: PETSc.Vec, mass: NodalMass, step: float, v: Array, a: Array | None = None
    ) -> Array:
        """Make velocity and acceleration, (local dofs,), those that the unknowns admit, in place.

        The step is that of `fem_snh.geometry.motions.rates.path_rates`. Returns the part of the
        nodes' acceleration that does not depend on forces, of the size of ``dofs``.
        """

    def states(self, x: PETSc.Vec, gradient: PETSc.Vec) -> dict[str, dict[str, list[float]]]:
        """Return what run.json has of a state, by name."""
