"""A boundary value problem: unknowns, element, materials, energy terms, Dirichlet conditions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from math import isfinite
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh._petsc import aij_blocks
from fem_snh.assembly.assembled_matrix import create_matrix
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.cell_loops import CellLoops
from fem_snh.assembly.elements import Element
from fem_snh.assembly.regions import Region, reference_modulus, without_cells
from fem_snh.assembly.unknowns import (
    Displacement,
    DisplacementPressure,
    local_values,
    nodes_of_other_cells,
    pressure_unit,
    rigid_motions,
    summed_over_cells,
    with_ghosts,
)
from fem_snh.cache import timed
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material
from fem_snh.linalg.direct_solver import is_symmetric
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.mesh.mesh import cell_volumes, volume
from fem_snh.mesh.mesh_checks import check_force_scale
from fem_snh.problem.mixed.taylor_hood import PressureBlock
from fem_snh.problem.reactions import Reactions
from fem_snh.problem.regime import Paths, regime_of
from fem_snh.solver.protocol import Regime
from fem_snh.terms.body import MotionInTime
from fem_snh.terms.elastic import Elastic, loops_over
from fem_snh.terms.history import TermHistory
from fem_snh.terms.rank_one import RankOneUpdate
from fem_snh.terms.term import CouplingTerm, StepLimit, Term

if TYPE_CHECKING:
    from fem_snh.problem.definition import Definition
    from fem_snh.terms.rigid_parts import RigidParts

Array = npt.NDArray[Any]

#: Relative rounding error of a number.
_EPS = float(np.finfo(float).eps)
#: Forces of a constant pressure on what is free, relative to all of them, that are rounding.
_NO_FORCE = 1e-9


class Problem:
    """The energy of a body at a given load, whose minimiser is the displacement. Collective.

    With an unknown pressure both are at a saddle point of it.

    Parameters
    ----------
    unknowns : Displacement
        The displacement, or displacement and pressure.
    element : Element
        Quadrature and volume treatment; it must fit the unknowns.
    regions : sequence of Region
        The materials and the cells that each of them fills.
    dirichlet : Dirichlet
        The constrained dofs and their values.
    terms : sequence of Term, optional
        The energy terms and forces beside the elastic energy.
    reactions : Reactions, optional
        The groups whose reaction forces `reactions` returns.
    parts : mapping of arrays, optional
        Cells, among those this rank owns, of the parts whose volume ratios `measures` returns.
    motion : MotionInTime, optional
        The motion in time, whose terms are among ``terms``.
    skin : Skin, optional
        The surface that a lattice carries.

    Attributes
    ----------
    domain : dolfinx Mesh
    V, u : dolfinx function space and Function
        The displacement's space; the displacement [m] that was evaluated last, ghosts included.
    x : PETSc.Vec
        The unknowns: the displacement's dofs, then a pressure's if there is one.
    matrix : BlockMatrix
        The matrix to which the terms add their Hessians.
    A : PETSc.Mat
        Its PETSc matrix, which `jacobian` fills; its near null space holds the rigid motions.
    operator : PETSc.Mat
        The Hessian: ``A``, plus matrices of rank one if a term has them.
    saddle_point : PressureBlock or None
        What a solver needs to know of a Taylor-Hood element's pressure.
    terms, history : list of Term, TermHistory
        All terms, the elastic energy first; what they keep from step to step.
    coupling_terms : list of CouplingTerm
        Those that couple nodes of different cells: surfaces of the body that touch each other.
    dirichlet : Dirichlet
        The constrained dofs and their values.
    rigid_cells : (n,) int
        This rank's own cells that are not assembled: those in rigid parts.
    rigid : RigidParts or None
        The rigid parts, whose nodes follow six unknowns each.
    largest_step : StepLimit or None
        The part of a step that the terms admit; None if they admit every step.
    constrained_dofs : (n,) int
        The constrained dofs this rank owns, as indices into the local part of ``x``.
    kinematics : Kinematics
        How the displacement becomes a deformation gradient. On a plane, energies are per thickness
        [J/m] and forces are [N/m]; on a body of revolution both are of the whole turn.
    load, length : float
        The load parameter, 0 to 1; V^(1/3) [m], V the reference volume; of a plane the root of the
        area.
    modulus, force_scale : float
        The scale E of the moduli [Pa] (`fem_snh.assembly.regions.reference_modulus`); E V^(2/3)
        [N], of a plane E times `length` [N/m].
    definition : Definition
        What it was made of, if `fem_snh.problem.definition.Definition.problem` made it.
    asymmetric : bool
        Whether the last Hessian is not symmetric.
    nonfinite : int
        Number of energies evaluated so far that were infinite or NaN.
    seconds : dict of float
        Time for evaluations ("assemble"), without compilation.

    Raises
    ------
    BadInput
        On every rank, if the element does not support a material.
    """

    definition: Definition

    def __init__(
        self,
        unknowns: Displacement,
        element: Element,
        regions: Sequence[Region],
        dirichlet: Dirichlet,
        terms: Sequence[Term] = (),
        reactions: Reactions | None = None,
        parts: Mapping[str, Array] | None = None,
        motion: MotionInTime | None = None,
        skin: Skin | None = None,
    ) -> None:
        self._unknowns, self.element = unknowns, element
        eliminating: list[Any] = [term for term in terms if term.eliminates]
        self.rigid: RigidParts | None = eliminating[0] if eliminating else None
        self.regions = given = list(regions)
        self.rigid_cells = self.rigid.cells if self.rigid else np.empty(0, np.int64)
        if unknowns.V.mesh.comm.allreduce(len(self.rigid_cells)):
            regions = without_cells(unknowns.V.mesh.comm, regions, self.rigid_cells)
        self.dirichlet, self._reactions, self._parts = dirichlet, reactions, parts
        self.V, self.u, self.x = unknowns.V, unknowns.u, unknowns.x
        self.domain, self.comm = self.V.mesh, self.V.mesh.comm
        self.kinematics = element.kinematics
        dim, revolved = self.kinematics.volume_dimension, self.kinematics.revolved
        self.length = volume(self.domain, revolved) ** (1 / dim)
        # A body that is rigid as a whole has the unit of its material.
        self.modulus = reference_modulus(self.domain, regions or given, revolved)
        self.force_scale = self.modulus * self.length ** (dim - 1)
        check_force_scale(self.force_scale)
        self.load, self.nonfinite = 0.0, 0
        self.motion, self.skin = motion, skin
        self.constrained_dofs = dirichlet.dofs
        scale = pressure_unit(element, self.num_cells) * self.modulus / self.length
        self.elastic = Elastic(self.V, element, regions, unknowns.Q, scale)
        self.matrix = create_matrix(self.V, unknowns.Q, dirichlet.constrained, dirichlet.planes)
        self.A = self.matrix.mat
        if self.rigid:
            eliminated = self.rigid.eliminate(self.matrix)
            self.constrained_dofs = np.union1d(self.constrained_dofs, eliminated)
        self.saddle_point: PressureBlock | None = None
        if isinstance(unknowns, DisplacementPressure):
            idle = np.flatnonzero(~nodes_of_other_cells(unknowns.Q, self.rigid_cells))
            self.matrix.idle = self.owned_displacements + idle
            self.saddle_point = PressureBlock(unknowns, self.elastic.parts, scale, self.A, idle)
        else:
            motions = rigid_motions(self.comm, self.coordinates, dirichlet.project, self.kinematics)
            self.A.setNearNullSpace(motions)
        self.terms: list[Term] = [self.elastic, *terms]
        self.history = TermHistory(self.terms)
        self.largest_step = StepLimit.of(
            self.terms, unknowns.num_owned_nodes, self.kinematics.components
        )
        self.coupling_terms = [term for term in self.terms if isinstance(term, CouplingTerm)]
        self._asymmetric_terms = [term for term in self.terms if not term.symmetric]
        self.asymmetric = False
        self._rank_one = RankOneUpdate.of(self.terms, self.A, self.V, self.project)
        self.operator = self._rank_one.mat if self._rank_one else self.A
        self.seconds = {"assemble": 0.0}

    @property
    def num_cells(self) -> int:
        """Cells on all ranks."""
        return _dolfinx.num_cells(self.domain)

    @property
    def has_energy(self) -> bool:
        """Whether all terms are energies: their residual is a gradient."""
        return all(term.has_energy for term in self.terms)

    @property
    def constrained_nodes(self) -> Array:
        """(n,) bool: which of this rank's own nodes have a constrained direction."""
        found = self.dirichlet.constrained_nodes[: len(self.coordinates)]
        if self.rigid:
            found[self.rigid.nodes] = True
        return found

    @cached_property
    def regime(self) -> Regime:
        """What a solver chooses its defaults by. Collective."""
        body = self.coordinates, self.element, self.elastic.parts
        return regime_of(self.comm, *body, self.terms, self.constrained_nodes)

    @cached_property
    def pressure_level_is_free(self) -> bool:
        """Whether an unknown pressure is determined up to a constant only. Collective.

        It is at nu = 1/2 where the whole boundary is prescribed: a constant pressure then does no
        work along any displacement that is free.
        """
        finite = any(isfinite(part.region.material.lame[1]) for part in self.elastic.parts)
        if self.saddle_point is None or finite:
            return False
        x, r, other = (self.x.duplicate() for _ in range(3))
        x.set(0.0)
        with self.kept_fields():
            self.gradient(x, r, [self.elastic])
            self.saddle_point.pressure_dofs(x)[:] = 1.0
            self.gradient(x, other, [self.elastic])
        forces = other - r
        self.saddle_point.pressure_dofs(forces)[:] = 0.0
        whole = forces.norm()
        if self.rigid:
            self.rigid.reduce(x, forces)
        self.project(forces.array)
        return bool(forces.norm() <= _NO_FORCE * whole)

    @property
    def symmetric(self) -> bool:
        """Whether exact Hessians have no part that is not symmetric, at any state."""
        return not self._asymmetric_terms

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of all penalties; return whether there are any."""
        return any([term.scale_penalties(factor) for term in self.terms])

    @contextmanager
    def kept_fields(self) -> Iterator[None]:
        """Keep the values of ``u``, a program's initial guess, while other ``x`` are evaluated."""
        with self._unknowns.kept_fields():
            yield

    @cached_property
    def retraction(self) -> Paths | None:
        """The path of a step, along which stiff and rigid parts turn, or None. Collective."""
        deformable = [part.region for part in self.elastic.parts]
        fixed = self.dirichlet.constrained[: len(self.coordinates)]
        excluded = np.zeros(len(fixed), bool)
        if planes := self.dirichlet.planes:
            excluded[planes.nodes[: planes.num_owned]] = True
        if self.rigid:
            excluded[self.rigid.nodes] = True
        return Paths.of(self.V, deformable, fixed, excluded, self.rigid)

    @property
    def step_end(self) -> Callable[[PETSc.Vec], None] | None:
        """`prescribe`, for nodes in inclined planes, which inexact linear solves leave; or None."""
        return self.prescribe if self.dirichlet.planes else None

    def largest_force(self, x: PETSc.Vec) -> float:
        """Return the largest norm of a term's forces on all dofs [N]. Collective.

        At an equilibrium the elastic forces balance loads and contact on free dofs, and are the
        reactions on constrained ones. Loads on rigid parts count as well.
        """
        return max(norm for _, norm, _ in self.force_norms(x))

    def force_norms(self, x: PETSc.Vec) -> Iterator[tuple[Term, float, bool]]:
        """Yield each term with the norm of its forces on all dofs [N]. Collective.

        And whether they are rounding at rest: those of springs, and of energies in UFL. The loads,
        drives and springs of rigid parts come one by one, on their unknowns.
        """
        if self.rigid:
            loads, drives, springs = self.rigid.force_norms(x)
            yield from ((self.rigid, norm, False) for norm in (loads, drives))
            yield self.rigid, springs, True
        force = self.x.duplicate()
        for term in self.terms:
            self.gradient(x, force, [term])
            yield term, force.norm(), term.rounds_identity

    def rounding_force(self, x: PETSc.Vec, least: float = 0.0) -> float:
        r"""Return a bound of the residual's rounding error [N]; 0 where it is below ``least``.

        .. math:: \epsilon \left\| |A| \, m \right\|_2

        (Tisseur 2001), A the Hessian assembled last. The size m of an unknown is :math:`|x|`.
        It is that of the position :math:`|X| + |x|` where positions decide: in cells with rigid
        nodes, and at nodes that touch something; where no force acts and the body is at rest; and
        that of a cell more where an energy is a UFL form, which rounds F = I + H. Collective.
        """
        sizes, positions = self.x.duplicate(), self.x.duplicate()
        positions.set(0.0)
        X = np.abs(self.coordinates[:, : self._unknowns.components])
        positions.array[: self.owned_displacements] = X.ravel()
        sizes.array[:] = np.abs(x.array_r)
        whole = sizes + positions
        extents = [term.extent for term in self.terms]
        whole.shift(max([*extents, self.length]))
        if _EPS * self.A.norm(PETSc.NormType.NORM_INFINITY) * whole.norm() < least:
            return 0.0
        at_rest = sizes.max()[1] <= _EPS * self.length
        decisive, force = np.zeros(len(positions.array_r), bool), self.x.duplicate()
        for term in self.terms:
            is_contact = term.has_penalties or term in self.coupling_terms
            if term is self.elastic or not (is_contact or at_rest):
                continue
            self.gradient(x, force, [term])
            if is_contact:
                touching = force.array_r != 0.0
                decisive |= touching
                positions.array[touching] += term.extent
            at_rest = at_rest and force.norm() == 0.0
        if self.rigid:
            decisive[: self.owned_displacements] |= self._beside_rigid
        if at_rest:
            decisive[:] = True
        sizes.array[decisive] += positions.array_r[decisive]
        if any(term.rounds_identity for term in self.terms):
            sizes.array[:] += self.length / self.regime.nodes ** (1 / self.kinematics.dim)
        absolute, product = self.A.duplicate(copy=True), self.x.duplicate()
        with aij_blocks(absolute) as blocks:
            for block in blocks:
                np.abs(block.array(), out=block.array())
        absolute.mult(sizes, product)
        absolute.destroy()
        self.project(product.array)
        return float(_EPS * product.norm())

    @cached_property
    def _beside_rigid(self) -> Array:
        """(owned displacements,) bool: which are in a cell with rigid nodes. Collective.

        A matrix has no columns of rigid nodes, whose rounded positions load the nodes beside them.
        """
        assert self.rigid
        rigid = np.zeros(self.owned_displacements)
        rigid[self.rigid.dofs] = 1.0
        components = self._unknowns.components
        marked = with_ghosts(self.V, rigid).reshape(-1, components)[_dolfinx.node_dofs(self.V)]
        cells = np.broadcast_to(marked.max(axis=1, keepdims=True), marked.shape)
        found = summed_over_cells(self.V, cells).ravel()[: self.owned_displacements] > 0
        return np.asarray(found)

    @property
    def coordinates(self) -> Array:
        """(n, 3) reference coordinates [m] of the displacement nodes that this rank owns."""
        return self.V.tabulate_dof_coordinates()[: self._unknowns.num_owned_nodes]

    @property
    def dofs(self) -> int:
        """Degrees of freedom on all ranks, constrained ones included."""
        return int(self.x.getSize())

    @property
    def owned_displacements(self) -> int:
        """The displacement's degrees of freedom that this rank owns, the first entries of ``x``."""
        return self._unknowns.components * self._unknowns.num_owned_nodes

    @property
    def depends_on_load(self) -> bool:
        """Whether a boundary value or a term depends on the load."""
        return self.dirichlet.depends_on_load or any(term.depends_on_load for term in self.terms)

    def set_load(self, load: float) -> None:
        """Set the load parameter, 0 to 1, of boundary values and terms."""
        self.load = load
        self.dirichlet.set_load(load)
        for term in self.terms:
            term.set_load(load)

    def interpolate(self, other: Problem) -> None:
        """Set ``x`` to the displacement of a problem on the same cells, at its load. Collective.

        What is constrained has its own values, and unknown pressures are zero.
        """
        self.set_load(other.load)
        other.split(other.x)
        self.u.interpolate(other.u)
        displacements = self.u.x.array[: self.owned_displacements].copy()
        self.x.set(0.0)  # without pressures, x is u's own vector
        self.x.array[: len(displacements)] = displacements
        self.prescribe(self.x)

    def update_lagged(self) -> bool:
        """Update the terms' lagged quantities at ``x``; return whether to solve again. Collective.

        It raises `NotSettled` as `TermHistory.update_lagged` does.
        """
        return self.history.update_lagged(self.split(self.x)[0])

    def prescribe(self, x: PETSc.Vec) -> None:
        """Set what is constrained of ``x`` to its values at the present load."""
        poses = self.rigid.poses(x) if self.rigid else None
        self.dirichlet.set_values(x, self.load)
        if self.rigid:
            self.rigid.prescribe(x, self.load, poses)

    def project(self, values: Array) -> None:
        """Set what is constrained of this rank's part of a vector like ``x`` to zero, in place."""
        values[self.constrained_dofs] = 0.0
        self.dirichlet.project(values)

    def split(self, x: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec | None]:
        """Update ``u``, and the pressure, from ``x``; return their ghosted vectors. Collective."""
        return self._unknowns.split(x)

    @timed
    def energy(self, x: PETSc.Vec) -> float:
        """Return the energy of all terms [J]; +inf outside the material's domain. Collective.

        It raises BadInput if a term has no energy.
        """
        u, p = self._unknowns.split(x)
        energy = sum(term.energy(u, p) for term in self.terms)
        self.nonfinite += not isfinite(energy)
        return energy

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Assemble r = dE/dx [N], zero in constrained directions. Collective."""
        self.gradient(x, r)
        if self.rigid:
            self.rigid.reduce(x, r)
        self.project(r.array)

    @timed
    def gradient(self, x: PETSc.Vec, r: PETSc.Vec, terms: Sequence[Term] | None = None) -> None:
        """Assemble r = dE/dx [N] of all terms or of some, with the reactions. Collective."""
        u, p = self._unknowns.split(x)
        with self._unknowns.residual(r) as (r_u, r_p):
            for term in self.terms if terms is None else terms:
                term.add_residual(u, p, r_u, r_p)

    @timed
    def jacobian(self, x: PETSc.Vec, filter: str, whole: bool = False) -> int:
        """Fill ``A`` with the Hessian d2E/dx2 [N/m]. Collective.

        ``filter``, one of `fem_snh.choices.FILTERS`, decides what becomes of negative eigenvalues.
        Of forces without an energy it has the symmetric part, or if it is exact the ``whole`` of
        their derivative. The result is the number of filtered quadrature points and cells, on all
        ranks.
        """
        for term in self._asymmetric_terms:
            term.symmetric = not whole
        u, p = self.split(x)
        if self.rigid or self._rank_one:
            force = self.x.duplicate()
            self.gradient(x, force)
            if self._rank_one:
                reduce = partial(self.rigid.reduce_vector, x) if self.rigid else None
                self._rank_one.update(u, force, reduce)
            if self.rigid:
                self.rigid.prepare(x, force, filter, whole and not self.symmetric)
            u, p = self.split(x)
        if self.coupling_terms:
            self.matrix.couple([term.couplings(u) for term in self.coupling_terms])
        with self.matrix.adding():
            filtered = sum(term.add_hessian(u, p, filter, self.matrix) for term in self.terms)
        may_be = whole and filter == "exact" and not self.symmetric
        self.asymmetric = may_be and not is_symmetric(self.A)
        return int(self.comm.allreduce(filtered))

    def reactions(self, x: PETSc.Vec) -> dict[str, list[float]]:
        """Return the reaction force [N] of each of the chosen groups. Collective.

        The sum of dE/du over the group's nodes: the force that the constraint exerts on the body.
        """
        return self.reaction_sums(x).get("reactions", {})

    @property
    def reaction_notes(self) -> list[str]:
        """Lines on the groups of `reactions` that have forces of other groups' conditions."""
        return self._reactions.notes if self._reactions else []

    def reaction_sums(self, x: PETSc.Vec) -> dict[str, dict[str, list[float]]]:
        """Return the forces and moments that `Reactions.sums` describes. Collective."""
        if self._reactions is None:
            return {}
        r = self.x.duplicate()
        self.gradient(x, r)
        return self._reactions.sums(x.array_r, r.array_r)

    def rigid_states(self, x: PETSc.Vec) -> dict[str, dict[str, list[float]]]:
        """Return poses, forces and moments of the rigid parts, by name. Collective."""
        if self.rigid is None:
            return {}
        r = self.x.duplicate()
        self.gradient(x, r)
        return self.rigid.states(x, r)

    def cell_fields(self, x: PETSc.Vec) -> dict[str, Array]:
        """Return fields with one value for each cell of this rank. Collective.

        Reference and deformed volume ("volume", "deformed_volume") [m^3], smallest J ("min_J"),
        "energy" [J], and smallest eigenvalue of d2psi/dF2 ("min_eigenvalue") [Pa]. In cells without
        a material, whose energy is a term, the energy is 0 and the eigenvalue -inf: unknown.
        """
        fields = self.elastic.cell_fields(*self._unknowns.split(x))
        if self._bare:
            cells, loops = self._bare
            unknown = {"energy": 0.0, "min_eigenvalue": -np.inf}
            for name, values in loops.fields(local_values(self._unknowns.split(x)[0])).items():
                fields[name][cells] = unknown.get(name, values)
        if len(cells := self.rigid_cells):
            volumes = cell_volumes(self.domain)[cells]
            rest = {"volume": volumes, "deformed_volume": volumes, "min_J": 1.0}
            for name, values in fields.items():
                values[cells] = rest.get(name, 0.0)
        return fields

    @cached_property
    def _bare(self) -> tuple[Array, CellLoops] | None:
        """The cells of this rank without a material, and loops over them. Collective.

        Those of the simplest material have volumes and J, in plane stress those of the plane: the
        thickness depends on the energy. None if all cells have a material.
        """
        filled = [part.region.cells for part in self.elastic.parts]
        number = np.arange(self.elastic.shape[0], dtype=np.int32)
        cells = np.setdiff1d(number, np.concatenate([*filled, self.rigid_cells]))
        if not self.comm.allreduce(len(cells)):
            return None
        kinematics = replace(self.kinematics, plane_stress=False)
        element = replace(
            self.element, volume="pointwise", pressure_degree=0, kinematics=kinematics
        )
        region = Region(material("stable_neo_hookean", E=1.0, nu=0.3), cells)
        return cells, loops_over(self.V, element, region)

    def measures(self, x: PETSc.Vec) -> dict[str, Any]:
        """Return the measures of the body that `body_measures` describes. Collective."""
        return body_measures(self.comm, self.cell_fields(x), self.nodal(x), self._parts)

    def nodal(self, x: PETSc.Vec) -> Array:
        """Return the displacement's entries of ``x`` at the nodes of this rank, (n, components)."""
        values: Array = x.array_r[: self.owned_displacements]
        return values.reshape(-1, self._unknowns.components)


def check_converged(reason: str, asked: str) -> None:
    """Raise BadInput, with what asks for a solution, unless the last solve found one."""
    if not reason.startswith("CONVERGED"):
        raise BadInput(f"{asked}: expected a solution that has converged: call solve()")


def body_measures(
    comm: MPI.Intracomm,
    cell_fields: dict[str, Array],
    u: Array,
    parts: Mapping[str, Array] | None = None,
) -> dict[str, Any]:
    """Return measures of the whole body. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The communicator of the mesh.
    cell_fields : dict of arrays
        Volumes [m^3] and smallest J of this rank's cells.
    u : (n, components) array
        Displacement [m] of this rank's nodes.
    parts : mapping of arrays, optional
        Cells of parts of the body, as `Problem` takes them.

    Returns
    -------
    dict
        ``volume_ratio``, deformed over reference volume; ``min_J``, the smallest J at a quadrature
        point; ``min_cell_J``, the smallest mean of J over a cell; ``max_u``, the largest nodal
        displacement [m]; ``volumes``, the volume ratio of each part, if there are parts.
    """
    max_u = float(np.sqrt((u**2).sum(axis=1).max(initial=0.0)))
    cells: list[Any] = [slice(None), *(parts or {}).values()]
    volumes = [cell_fields[key] for key in ("deformed_volume", "volume")]
    deformed, rest = comm.allreduce(np.array([[v[c].sum() for c in cells] for v in volumes]))
    ratios = (deformed / rest).tolist()
    min_J = float(cell_fields["min_J"].min(initial=np.inf))
    mean_J = cell_fields["deformed_volume"] / cell_fields["volume"]
    min_cell_J = float(mean_J.min(initial=np.inf))
    found = {
        "volume_ratio": ratios[0],
        "min_J": float(comm.allreduce(min_J, op=MPI.MIN)),
        "min_cell_J": float(comm.allreduce(min_cell_J, op=MPI.MIN)),
        "max_u": float(comm.allreduce(max_u, op=MPI.MAX)),
    }
    return found | ({"volumes": dict(zip(parts, ratios[1:], strict=True))} if parts else {})
