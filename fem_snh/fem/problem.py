"""A boundary value problem: mesh, element, material, energy terms and boundary conditions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from math import isfinite
from time import perf_counter
from typing import Any, TypeVar

from petsc4py import PETSc

import numpy.typing as npt

from fem_snh.choices import EIGENSOLVERS
from fem_snh.errors import BadInput, bad_value, choose
from fem_snh.fem import mesh as meshes
from fem_snh.fem.boundary_conditions import Constraint, DirichletConditions, Motion
from fem_snh.fem.elements import Element
from fem_snh.fem.measures import Reactions, body_measures
from fem_snh.fem.mesh import Mesh
from fem_snh.fem.near_null_space import rigid_motions
from fem_snh.fem.taylor_hood import SaddlePoint
from fem_snh.fem.terms import Elastic, Term, Traction
from fem_snh.fem.terms.traction import SurfaceLoad
from fem_snh.fem.unknowns import DisplacementPressure, create_unknowns
from fem_snh.kernels.pointwise import Material

Array = npt.NDArray[Any]

T = TypeVar("T")


def _timed(method: Callable[..., T]) -> Callable[..., T]:
    """Add a method's run time to ``seconds["assemble"]``."""

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

    With a Taylor-Hood element: find displacement and pressure at a saddle point of the energy.

    Parameters
    ----------
    mesh : Mesh
        The body in its reference configuration.
    element : Element
        The finite element; its cell must be the mesh's.
    material : Material
        The material of the whole body.
    hold : sequence of Constraint, optional
        Components of the displacement that are zero on physical groups.
    move : sequence of Motion, optional
        Components of the displacement that follow the load on physical groups.
    traction : sequence of SurfaceLoad, optional
        Dead loads on physical groups of surfaces.
    reactions : sequence of str or int, optional
        Physical groups whose reaction forces `reactions` returns.
    eigensolver : str, optional
        Solver for the 3x3 scaling block of the Hessian, one of `fem_snh.choices.EIGENSOLVERS`.

    Attributes
    ----------
    V, u : dolfinx function space and Function
        The displacement's space; the displacement [m] that was evaluated last, ghosts included.
    x : PETSc.Vec
        The unknowns: the displacement's dofs, then a pressure's if there is one.
    A : PETSc.Mat
        The matrix that `jacobian` fills; its near null space holds the rigid motions.
    saddle_point : SaddlePoint or None
        What a solver needs to know of a Taylor-Hood element's pressure.
    terms : list of Term
        The energy terms.
    constrained_dofs : (n,) int
        The constrained dofs this rank owns, as indices into the local part of ``x``.
    load : float
        The load parameter, 0 to 1; see `set_load`.
    length : float
        V^(1/3) [m], V the reference volume.
    force_scale : float
        E V^(2/3) [N], which residual norms are compared with.
    nonfinite : int
        Number of energies evaluated so far that were infinite or NaN.
    seconds : dict of float
        Time for compilation ("jit") and for evaluations ("assemble").

    Raises
    ------
    BadInput
        On every rank, if mesh, element, material and physical groups do not fit together.
    """

    def __init__(
        self,
        mesh: Mesh,
        element: Element,
        material: Material,
        *,
        hold: Sequence[Constraint] = (),
        move: Sequence[Motion] = (),
        traction: Sequence[SurfaceLoad] = (),
        reactions: Sequence[str | int] = (),
        eigensolver: str = EIGENSOLVERS[0],
    ) -> None:
        if mesh.cell != element.cell:
            accepted = f"an element with {mesh.cell} cells, like the mesh; it has {element.cell}s"
            raise bad_value("element", element.name, accepted)
        self.mesh, self.element, self.material = mesh, element, material
        self.eigensolver = choose("eigensolver", eigensolver, EIGENSOLVERS)
        self.comm = mesh.domain.comm
        self.length = meshes.volume(mesh.domain) ** (1 / 3)
        self.force_scale = material.expression.E * self.length**2
        self.load, self.nonfinite = 0.0, 0

        unknowns = self._unknowns = create_unknowns(mesh, element)
        self.V, self.u, self.x = unknowns.V, unknowns.u, unknowns.x
        self._dirichlet = DirichletConditions(self.V, mesh, hold, move)
        self.constrained_dofs = self._dirichlet.dofs
        constrained = self._dirichlet.constrained
        self.saddle_point: SaddlePoint | None = None
        if isinstance(unknowns, DisplacementPressure):
            scale = material.expression.E / self.length
            self.elastic = Elastic(self.V, element, material, constrained, unknowns.Q, scale)
            energy, mu_lame = self.elastic.element_energy, material.lame[0]
            self.saddle_point = SaddlePoint(unknowns, energy, scale, mu_lame)
        else:
            self.elastic = Elastic(self.V, element, material, constrained)
        self.A = self.elastic.matrix
        if not self.saddle_point:
            free = ~constrained[: unknowns.num_owned_nodes]
            self.A.setNearNullSpace(rigid_motions(self.comm, self.coordinates, free))
        self._traction = Traction(self.V, mesh, traction) if traction else None
        self.terms: list[Term] = [self.elastic, *([self._traction] if self._traction else [])]
        self._reactions = Reactions(self.V, mesh, reactions)
        self.seconds = {"jit": self.elastic.jit_seconds, "assemble": 0.0}

    @property
    def has_energy(self) -> bool:
        """Whether the material's stress is the gradient of an energy."""
        return self.material.expression.has_energy

    @property
    def coordinates(self) -> Array:
        """(n, 3) reference coordinates [m] of the displacement nodes that this rank owns."""
        return self.V.tabulate_dof_coordinates()[: self._unknowns.num_owned_nodes]

    @property
    def dofs(self) -> int:
        """Degrees of freedom on all ranks, constrained ones included."""
        return int(self.x.getSize())

    @property
    def depends_on_load(self) -> bool:
        """Whether a boundary value or a traction depends on the load."""
        return bool(self._dirichlet.follow_load or self._traction)

    def set_load(self, load: float) -> None:
        """Set the load parameter, 0 to 1, of boundary values and tractions."""
        self.load = load
        if self._traction:
            self._traction.load = load

    def prescribe(self, x: PETSc.Vec) -> None:
        """Set the constrained entries of ``x`` to their values at the present load."""
        self._dirichlet.set_values(x, self.load)

    def update_functions(self) -> None:
        """Update the displacement ``u``, and the pressure, from ``x``. Collective."""
        self._unknowns.split(self.x)

    @_timed
    def energy(self, x: PETSc.Vec) -> float:
        """Return the energy of all terms [J]; +inf outside the material's domain. Collective.

        Raises
        ------
        BadInput
            If the material has a stress but no energy.
        """
        if not self.has_energy:
            raise BadInput(f"material '{self.material.name}' has no energy, only a stress")
        u, p = self._unknowns.split(x)
        energy = sum(term.energy(u, p) for term in self.terms)
        self.nonfinite += not isfinite(energy)
        return energy

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Assemble r = dE/dx [N], with zeros at constrained dofs. Collective."""
        self.gradient(x, r)
        r.array[self.constrained_dofs] = 0.0

    @_timed
    def gradient(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Assemble r = dE/dx [N], with the reactions at constrained dofs. Collective."""
        u, p = self._unknowns.split(x)
        with self._unknowns.residual(r) as (r_u, r_p):
            for term in self.terms:
                term.add_residual(u, p, r_u, r_p)

    @_timed
    def jacobian(self, x: PETSc.Vec, filter: str) -> int:
        """Fill ``A`` with the Hessian d2E/dx2 [N/m]. Collective.

        Parameters
        ----------
        x : PETSc.Vec
            The state.
        filter : {"exact", "clamp", "abs"}
            What becomes of negative eigenvalues at each quadrature point.

        Returns
        -------
        int
            The number of filtered quadrature points, on all ranks.
        """
        return self.elastic.jacobian(*self._unknowns.split(x), filter, self.eigensolver)

    def reactions(self, x: PETSc.Vec) -> dict[str, list[float]]:
        """Return the reaction force [N] of each of the chosen groups. Collective.

        The sum of dE/du over the group's nodes: the force that the constraint exerts on the body.
        """
        if not self._reactions.groups:
            return {}
        r = self.x.duplicate()
        self.gradient(x, r)
        return self._reactions.sum(r.array_r)

    def cell_fields(self, x: PETSc.Vec) -> dict[str, Array]:
        """Return fields with one value for each cell of this rank. Collective.

        Reference and deformed volume ("volume", "deformed_volume") [m^3], smallest J ("min_J"),
        "energy" [J], and smallest eigenvalue of d2psi/dF2 ("min_eigenvalue") [Pa].
        """
        return self.elastic.cell_fields(*self._unknowns.split(x))

    def measures(self, x: PETSc.Vec) -> dict[str, float]:
        """Return the measures of the body that `body_measures` describes. Collective."""
        u = x.array_r[: 3 * self._unknowns.num_owned_nodes].reshape(-1, 3)
        return body_measures(self.comm, self.cell_fields(x), u)
