"""Mesh, element, material, terms and conditions as one minimisation problem of the displacement.

Or, with a Taylor-Hood element, as a saddle: least in the displacement, greatest in the pressure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from math import isfinite
from time import perf_counter
from typing import Any, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.choices import EIGENSOLVERS
from fem_snh.errors import BadInput, choose
from fem_snh.fem import mesh as meshes
from fem_snh.fem import unknowns
from fem_snh.fem.elements import Element
from fem_snh.fem.mesh import Mesh
from fem_snh.fem.taylor_hood import SaddlePoint
from fem_snh.fem.terms import Elastic, Traction
from fem_snh.fem.unknowns import DisplacementPressure
from fem_snh.kernels.pointwise import Material

Array = npt.NDArray[Any]

_AXES = ("x", "y", "z")

T = TypeVar("T")


def _timed(method: Callable[..., T]) -> Callable[..., T]:
    """Count a method's time as assembly."""

    @wraps(method)
    def timed(self: Problem, *arguments: Any) -> T:
        start = perf_counter()
        try:
            return method(self, *arguments)
        finally:
            self.seconds["assemble"] += perf_counter() - start

    return timed


class Problem:
    """Find the displacement that minimises the energy at a given load. Collective.

    Parameters
    ----------
    hold : conditions with ``group`` and ``components`` (of "x", "y", "z"): displacement zero.
    move : the same with ``displacement(X, load)``: (n, 3) points to (n, 3).
    traction : loads with ``group`` and ``vector`` [Pa].
    reactions : names or numbers of the groups whose `reactions` are wanted.
    eigensolver : of the Hessian's 3x3 scaling block, one of EIGENSOLVERS.

    Attributes
    ----------
    u : the displacement, a dolfinx Function, ghosts included that of the vector last evaluated.
    x : the vector of the unknowns: the displacement's own, or one that holds a pressure, too.
    A : the matrix that `jacobian` fills, its near null space the rigid motions.
    saddle_point : None, or what a solver has to know of a Taylor-Hood element's pressure.
    terms : the energy terms the scene needs, and no others.
    length : V^(1/3) [m], V the reference volume.
    nonfinite : how many of the energies evaluated so far were infinite or NaN.
    seconds : spent in compilation ("jit") and in evaluations ("assemble").
    force_scale : E V^(2/3) [N]: the residual's norm is measured against it.

    Raises BadInput on every rank for an element that does not fit the mesh or an unknown group.
    """

    def __init__(
        self,
        mesh: Mesh,
        element: Element,
        material: Material,
        hold: Sequence[Any] = (),
        move: Sequence[Any] = (),
        traction: Sequence[Any] = (),
        reactions: Sequence[str | int] = (),
        eigensolver: str = EIGENSOLVERS[0],
    ) -> None:
        if mesh.cell != element.cell:
            raise BadInput(
                f"element '{element.name}' needs {element.cell} cells; the mesh has {mesh.cell}s"
            )
        self.mesh, self.element, self.material = mesh, element, material
        self.eigensolver = choose("eigensolver", eigensolver, EIGENSOLVERS)
        self.comm = mesh.domain.comm
        self.length = meshes.volume(mesh.domain) ** (1 / 3)
        self._unknowns = unknowns.create(mesh, element)
        self.V, self.u, self.x = self._unknowns.V, self._unknowns.u, self._unknowns.x
        self.load = 0.0
        self.nonfinite = 0
        self.saddle_point: SaddlePoint | None = None
        if isinstance(self._unknowns, DisplacementPressure):
            scale = material.expression.E / self.length
            self.elastic = Elastic(self.V, element, material, self._unknowns.Q, scale)
            self.saddle_point = SaddlePoint(self._unknowns, self.elastic, scale, material.lame[0])
        else:
            self.elastic = Elastic(self.V, element, material)
        self._traction = None
        if traction:
            self._traction = Traction(self.V, mesh, [(t.group, t.vector) for t in traction])
        self.terms: list[Any] = [self.elastic, *([self._traction] if self._traction else [])]
        self._condition(hold, move)
        self._reacting = {str(key): self._owned_nodes(key) for key in reactions}
        self.A = self.elastic.create_matrix(self._unknowns.layout())
        if not self.saddle_point:
            free = self.elastic.free[: len(self.coordinates)]
            self.A.setNearNullSpace(unknowns.rigid_motions(self.comm, self.coordinates, free))
        self.seconds = {"jit": self.elastic.jit_seconds, "assemble": 0.0}
        self.force_scale = material.expression.E * self.length**2

    @property
    def has_energy(self) -> bool:
        """Whether the material's stress is the gradient of an energy."""
        return self.material.expression.has_energy

    @property
    def coordinates(self) -> Array:
        """(n, 3) reference coordinates of the nodes that this rank owns [m]."""
        return self.V.tabulate_dof_coordinates()[: self._unknowns.owned]

    @property
    def dofs(self) -> int:
        """Degrees of freedom on all ranks, prescribed ones included."""
        return int(self.x.getSize())

    def _condition(self, hold: Sequence[Any], move: Sequence[Any]) -> None:
        """Find the prescribed degrees of freedom."""
        points = self.coordinates
        self._moved = []
        for condition in hold:
            self._fix(condition)
        for condition in move:
            nodes, axes = self._fix(condition)
            nodes = nodes[nodes < self._unknowns.owned]
            self._moved.append((nodes, axes, condition, points[nodes]))
        owned = self._unknowns.owned
        self._prescribed = np.flatnonzero(self.elastic.free[:owned].ravel() == 0)

    def _fix(self, condition: Any) -> tuple[Array, list[int]]:
        """Take a condition's degrees of freedom from the free ones: local nodes, components."""
        group = self.mesh.group(condition.group)
        nodes = _dolfinx.locate_dofs(self.V, group.dim, group.entities)
        axes = [_AXES.index(c) for c in condition.components]
        self.elastic.free[nodes[:, None], axes] = 0.0
        return nodes, axes

    def _owned_nodes(self, key: str | int) -> Array:
        """The nodes of a group that this rank owns. Collective."""
        group = self.mesh.group(key)
        nodes = _dolfinx.locate_dofs(self.V, group.dim, group.entities)
        return nodes[nodes < self._unknowns.owned]

    @property
    def depends_on_load(self) -> bool:
        """Whether anything depends on the load."""
        return bool(self._moved or self._traction)

    def set_load(self, load: float) -> None:
        """Set the load, 0 to 1; boundary values and tractions follow."""
        self.load = load
        if self._traction:
            self._traction.load = load

    def update_functions(self) -> None:
        """Bring ``u``, and the pressure, up to date with ``x``. Collective."""
        self._unknowns.displacement(self.x)

    def prescribe(self, x: PETSc.Vec) -> None:
        """Put the boundary values of the present load into ``x``."""
        values = x.array
        values[self._prescribed] = 0.0
        for nodes, axes, condition, points in self._moved:
            displacement = condition.displacement(points, self.load)
            values[3 * nodes[:, None] + axes] = displacement[:, axes]

    @_timed
    def energy(self, x: PETSc.Vec) -> float:
        """The energy of all terms [J]; +inf outside the material's domain.

        Raises BadInput for a material that has stresses and no energy.
        """
        if not self.has_energy:
            raise BadInput(
                f"material '{self.material.expression.name}' has no energy, only a stress"
            )
        u = self._unknowns.displacement(x)
        energy = sum(term.energy(u) for term in self.terms)
        self.nonfinite += not isfinite(energy)
        return energy

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """r = dE/du [N]; zero where the displacement is prescribed."""
        self.gradient(x, r)
        r.array[self._prescribed] = 0.0

    @_timed
    def gradient(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """r = dE/du [N] everywhere: at prescribed nodes, the reactions."""
        u, mine = self._unknowns.displacement(x), self._unknowns.begin_residual(r)
        for term in self.terms:
            term.add_residual(u, mine)
        self._unknowns.end_residual(r)

    @_timed
    def jacobian(self, x: PETSc.Vec, filter: str) -> int:
        """Fill ``A`` with the filtered d2E/du2 [N/m]; the number of quadrature points filtered."""
        return self.elastic.jacobian(self._unknowns.displacement(x), filter, self.eigensolver)

    def reactions(self, x: PETSc.Vec) -> dict[str, list[float]]:
        """For each of the groups asked for, the force [N] that its support exerts on the body.

        The sum of dE/du over the group's nodes: positive along the way a support pulls. Costs
        nothing where no group was asked for.
        """
        if not self._reacting:
            return {}
        r = self.x.duplicate()
        self.gradient(x, r)
        forces = r.array_r[: 3 * self._unknowns.owned].reshape(-1, 3)
        mine = np.array([forces[nodes].sum(axis=0) for nodes in self._reacting.values()])
        total = self.comm.allreduce(mine)
        return dict(zip(self._reacting, total.tolist(), strict=True))

    def fields(self, x: PETSc.Vec) -> dict[str, Array]:
        """Per owned cell: volumes [m^3], smallest J, energy [J], smallest eigenvalue [Pa]."""
        return self.elastic.fields(self._unknowns.displacement(x))

    def measures(self, x: PETSc.Vec) -> dict[str, float]:
        """Of the whole body: deformed over undeformed volume, smallest J, largest displacement.

        J [1] at any quadrature point, the displacement [m] at any node.
        """
        fields = self.fields(x)
        u = x.array_r[: 3 * self._unknowns.owned].reshape(-1, 3)
        most = float(np.sqrt((u**2).sum(axis=1).max(initial=0.0)))
        sums = np.array([fields["deformed_volume"].sum(), fields["volume"].sum()])
        deformed, volume = self.comm.allreduce(sums)
        least = float(fields["min_J"].min(initial=np.inf))
        return {
            "volume_ratio": float(deformed / volume),
            "min_J": float(self.comm.allreduce(least, op=MPI.MIN)),
            "max_u": float(self.comm.allreduce(most, op=MPI.MAX)),
        }
