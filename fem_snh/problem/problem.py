"""A discretised boundary value problem: unknowns, element, materials, terms, conditions."""

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

from fem_snh import _dolfinx
from fem_snh._petsc import as_aij, vector_like
from fem_snh.arrays import Array
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
from fem_snh.problem.reactions import Reactions
from fem_snh.problem.regime import Paths, regime_of
from fem_snh.solver.protocol import Regime
from fem_snh.terms.body import MotionInTime
from fem_snh.terms.elastic import Elastic, loops_over
from fem_snh.terms.history import TermHistory
from fem_snh.terms.rank_one import RankOneUpdate
from fem_snh.terms.term import CouplingTerm, StepLimit, Term

if TYPE_CHECKING:
    from fem_snh.assembly.assembled_matrix import BlockMatrix
    from fem_snh.problem.definition import Definition
    from fem_snh.problem.mixed.taylor_hood import PressureBlock
    from fem_snh.terms.rigid_parts import RigidParts

#: The machine epsilon of double precision.
_EPS = float(np.finfo(float).eps)
#: Forces of a constant pressure on free dofs that are rounding, over its forces on all dofs.
_NO_FORCE = 1e-9


class Problem:
    """A discretised energy of a body, whose minimiser is the displacement at a load. Collective.

    With an unknown pressure, displacement and pressure are a saddle point of the energy.

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
        Parts of the body by name, each the cells of it that this rank owns, (n,) int; `measures`
        returns their volume ratios.
    motion : MotionInTime, optional
        The motion in time, whose terms must be among ``terms``; None in statics.
    skin : Skin, optional
        The surface that a lattice carries.

    Attributes
    ----------
    domain : dolfinx Mesh
    V : dolfinx function space
        The displacement's space.
    u : dolfinx Function
        The displacement [m] of ``x``, whose memory it shares; with an unknown pressure, of the
        vector that was evaluated last, ghosts included.
    x : PETSc.Vec
        The unknowns; each rank has its displacement dofs first, then its pressure dofs if any.
    saddle_point : PressureBlock or None
        The pressure block; None without an unknown pressure.
    terms : list of Term
        All terms, the elastic energy first.
    history : TermHistory
        What the terms keep from step to step.
    coupling_terms : list of CouplingTerm
        The terms that couple nodes of different cells: contact between surfaces of the body.
    dirichlet : Dirichlet
        The constrained dofs and their values.
    rigid_cells : (n,) int
        The cells of rigid parts that this rank owns, which are not assembled.
    rigid : RigidParts or None
        The rigid parts; the nodes of each part follow its six unknowns.
    largest_step : StepLimit or None
        ``largest_step(x, d)`` returns the fraction of a step d that the terms admit; None if they
        admit every step.
    constrained_dofs : (n,) int
        The constrained dofs this rank owns, as indices into the local part of ``x``.
    kinematics : Kinematics
        How the displacement becomes a deformation gradient. On a plane, energies are per thickness
        [J/m] and forces are [N/m]; on a body of revolution both are of the whole turn.
    load : float
        The load parameter, 0 to 1.
    length : float
        V^(1/3) [m], V the reference volume; the root of the area of a plane.
    modulus : float
        The scale E of the moduli [Pa]: `fem_snh.assembly.regions.reference_modulus`.
    force_scale : float
        E V^(2/3) [N]; for a plane E times `length` [N/m].
    definition : Definition
        What created the problem; missing unless a `fem_snh.problem.definition.Definition` did.
    asymmetric : bool
        Whether the Hessian assembled last is not symmetric.
    nonfinite : int
        Number of energies evaluated so far that were infinite or NaN.
    seconds : dict of float
        {"assemble": seconds of all evaluations so far, without compilation}.

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
        # If the whole body is rigid, ``regions`` is empty: its given materials have the modulus.
        self.modulus = reference_modulus(self.domain, regions or given, revolved)
        self.force_scale = self.modulus * self.length ** (dim - 1)
        check_force_scale(self.force_scale)
        self.load, self.nonfinite = 0.0, 0
        self.motion, self.skin = motion, skin
        self.constrained_dofs = dirichlet.dofs
        scale = pressure_unit(element, self.num_cells) * self.modulus / self.length
        self.elastic = Elastic(self.V, element, regions, unknowns.Q, scale)
        self._half = False
        if self.rigid:
            eliminated = self.rigid.eliminate(self.matrix)
            self.constrained_dofs = np.union1d(self.constrained_dofs, eliminated)
        self.saddle_point: PressureBlock | None = None
        if isinstance(unknowns, DisplacementPressure):
            from fem_snh.problem.mixed.taylor_hood import PressureBlock

            idle = np.flatnonzero(~nodes_of_other_cells(unknowns.Q, self.rigid_cells))
            self.matrix.idle = self.owned_displacements + idle
            self.saddle_point = PressureBlock(unknowns, self.elastic.parts, scale, self.P, idle)
        self.terms: list[Term] = [self.elastic, *terms]
        self.history = TermHistory(self.terms)
        self.largest_step = StepLimit.of(
            self.terms, unknowns.num_owned_nodes, self.kinematics.components
        )
        self.coupling_terms = [term for term in self.terms if isinstance(term, CouplingTerm)]
        self._asymmetric_terms = [term for term in self.terms if not term.symmetric]
        self.asymmetric = False
        self._rank_one = RankOneUpdate.of(self.terms, lambda: self.P, self.V, self.project)
        self.seconds = {"assemble": 0.0}

    @cached_property
    def matrix(self) -> BlockMatrix:
        """The matrix to which the terms add their Hessians, made on first use. Collective."""
        V, unknowns, dirichlet = self.V, self._unknowns, self.dirichlet
        unit = self.force_scale / self.length if self._half else None
        matrix = create_matrix(V, unknowns.Q, dirichlet.constrained, dirichlet.planes, unit)
        if unknowns.Q is None:
            motions = rigid_motions(self.comm, self.coordinates, dirichlet.project, self.kinematics)
            matrix.mat.setNearNullSpace(motions)
        return matrix

    def store_half(self) -> None:
        """Let `matrix` store the half that the built-in linear solver reads, not AIJ, if it may.

        It may not once it exists, as it does with unknown pressures, rigid parts and matrices of
        rank one; nor with inclined planes, nor if a term needs AIJ or has no symmetric Hessian.
        """
        exists, aij = "matrix" in self.__dict__, any(term.needs_aij for term in self.terms)
        self._half = not (exists or aij or self._asymmetric_terms or self.dirichlet.planes)

    @property
    def P(self) -> PETSc.Mat:
        """The Mat that `jacobian` fills, of type AIJ, or "python" for a half. Collective.

        Without an unknown pressure its near null space holds the rigid motions.
        """
        return self.matrix.mat

    @property
    def A(self) -> PETSc.Mat:
        """`P` as an AIJ matrix, always the same object: a copy if a half is stored. Collective."""
        return as_aij(self.P)

    @property
    def is_assembled(self) -> bool:
        """Whether the Hessian is `P` alone, without matrices of rank one."""
        return self._rank_one is None

    @property
    def operator(self) -> PETSc.Mat:
        """The Hessian: `P`, or a MATLRC that adds matrices of rank one if a term has them."""
        return self._rank_one.mat if self._rank_one else self.P

    @property
    def num_cells(self) -> int:
        """Number of cells on all ranks."""
        return _dolfinx.num_cells(self.domain)

    @property
    def has_energy(self) -> bool:
        """Whether all terms have an energy, so that the residual is its gradient."""
        return all(term.has_energy for term in self.terms)

    @property
    def constrained_nodes(self) -> Array:
        """(owned nodes,) bool: which nodes have a constrained direction or are on a rigid part."""
        found = self.dirichlet.constrained_nodes[: len(self.coordinates)]
        if self.rigid:
            found[self.rigid.nodes] = True
        return found

    @cached_property
    def regime(self) -> Regime:
        """The properties by which a solver chooses its defaults. Collective."""
        body = self.coordinates, self.element, self.elastic.parts
        return regime_of(self.comm, *body, self.terms, self.constrained_nodes)

    @cached_property
    def pressure_level_is_free(self) -> bool:
        """Whether an unknown pressure is determined up to a constant only. Collective.

        So it is at nu = 1/2 if the whole boundary is constrained: a constant pressure then does no
        work along any free displacement.
        """
        finite = any(isfinite(part.region.material.lame[1]) for part in self.elastic.parts)
        if self.saddle_point is None or finite:
            return False
        x = vector_like(self.x)
        with self.kept_fields():
            r = self.gradient_at(x, [self.elastic])
            self.saddle_point.pressure_dofs(x)[:] = 1.0
            forces = self.gradient_at(x, [self.elastic]) - r
        self.saddle_point.pressure_dofs(forces)[:] = 0.0
        whole = forces.norm()
        if self.rigid:
            self.rigid.reduce(x, forces)
        self.project(forces.array)
        return bool(forces.norm() <= _NO_FORCE * whole)

    @property
    def symmetric(self) -> bool:
        """Whether the exact Hessian is symmetric at every state."""
        return not self._asymmetric_terms

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of all penalties; return whether a term has penalties."""
        return any([term.scale_penalties(factor) for term in self.terms])

    @contextmanager
    def kept_fields(self) -> Iterator[None]:
        """Restore ``u``, a program's initial guess, and the pressure at the end of the context."""
        with self._unknowns.kept_fields():
            yield

    @cached_property
    def retraction(self) -> Paths | None:
        """The paths of steps, along which stiff and rigid parts rotate. Collective.

        None if all steps are straight.
        """
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
        """`prescribe` if nodes are in inclined planes, which inexact steps leave, else None."""
        return self.prescribe if self.dirichlet.planes else None

    def largest_force(self, x: PETSc.Vec) -> float:
        """Return the largest 2-norm of one term's forces on all dofs [N]. Collective.

        Constrained dofs count, so reactions do; loads, drives and springs of rigid parts count too.
        """
        return max(norm for _, norm, _ in self.force_norms(x))

    def force_norms(self, x: PETSc.Vec) -> Iterator[tuple[Term, float, bool]]:
        """Yield (term, norm, rounds) for each term. Collective.

        ``norm`` is the 2-norm of the term's forces on all dofs [N]. ``rounds`` tells whether the
        forces of the undeformed body are rounding errors, not zeros: springs of rigid parts, UFL
        energies. Rigid parts come three times, with their loads, drives and springs.
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
        r"""Return a bound of the residual's rounding error [N]; 0 if it is below ``least``.

        .. math:: \epsilon \left\| |A| \, m \right\|_2

        (Tisseur 2001), with the Hessian A assembled last and m the size of the numbers that are
        rounded at each dof: :math:`|x|`, but the position :math:`|X| + |x|` in cells with rigid
        nodes, where contact acts, and everywhere if the body is at rest without forces. If an
        energy is a UFL form, which rounds F = I + H, m is larger by the size of a cell. Collective.
        """
        X = np.abs(self.coordinates[:, : self._unknowns.components])
        sizes, positions = vector_like(x, np.abs(x.array_r)), vector_like(x, X.ravel())
        whole = sizes + positions
        extents = [term.extent for term in self.terms]
        whole.shift(max([*extents, self.length]))
        if _EPS * self.P.norm(PETSc.NormType.NORM_INFINITY) * whole.norm() < least:
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
        if at_rest:  # unknowns of rigid parts stand for all of their nodes, wherever these are
            decisive[:] = True
            sizes.shift(self.length)
        sizes.array[decisive] += positions.array_r[decisive]
        if any(term.rounds_identity for term in self.terms):
            sizes.array[:] += self.length / self.regime.nodes ** (1 / self.kinematics.dim)
        product = self.matrix.absolute_product(sizes)
        self.project(product.array)
        return float(_EPS * product.norm())

    @cached_property
    def _beside_rigid(self) -> Array:
        """(owned displacement dofs,) bool: which are in a cell with rigid nodes. Collective.

        `A` has no columns for rigid nodes, but their rounded positions load the nodes beside them.
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
        """(owned nodes, 3) reference coordinates [m] of the displacement nodes."""
        return self.V.tabulate_dof_coordinates()[: self._unknowns.num_owned_nodes]

    @property
    def dofs(self) -> int:
        """Number of degrees of freedom on all ranks, constrained ones included."""
        return int(self.x.getSize())

    @property
    def owned_displacements(self) -> int:
        """Number of displacement dofs that this rank owns: the first entries of ``x``."""
        return self._unknowns.components * self._unknowns.num_owned_nodes

    @property
    def depends_on_path(self) -> bool:
        """Whether a state depends on those before it: in time, with friction. Collective."""
        return self.motion is not None or self.history.is_kept(self.comm)

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
        """Set the load and ``x`` from a problem on the same cells. Collective.

        The displacement of ``other`` is interpolated. Constrained dofs get this problem's boundary
        values, and unknown pressures are zero.
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

        Raises
        ------
        NotSettled
            On every rank: see `TermHistory.update_lagged`.
        """
        return self.history.update_lagged(self.split(self.x)[0])

    def prescribe(self, x: PETSc.Vec) -> None:
        """Set constrained dofs and directions of ``x`` to their values at the present load."""
        poses = self.rigid.poses(x) if self.rigid else None
        self.dirichlet.set_values(x, self.load)
        if self.rigid:
            self.rigid.prescribe(x, self.load, poses)

    def project(self, values: Array) -> None:
        """Set constrained dofs and directions of a vector to zero, in place.

        ``values`` is this rank's part of a vector with the layout of ``x``.
        """
        values[self.constrained_dofs] = 0.0
        self.dirichlet.project(values)

    def split(self, x: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec | None]:
        """Return the ghosted vectors of displacement and pressure of ``x``. Collective.

        They are ``x``, with updated ghosts, and None; with an unknown pressure, the vectors of
        ``u`` and of the pressure, set to the values of ``x``.
        """
        return self._unknowns.split(x)

    @timed
    def energy(self, x: PETSc.Vec) -> float:
        """Return the energy of all terms [J]; +inf outside the material's domain. Collective.

        All terms must have an energy: see `has_energy`.
        """
        u, p = self._unknowns.split(x)
        energy = sum(term.energy(u, p) for term in self.terms)
        self.nonfinite += not isfinite(energy)
        return energy

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Assemble r = dE/dx [N], zero in constrained directions. Collective.

        Forces on rigid parts are forces on the parts' unknowns.
        """
        self.gradient(x, r)
        if self.rigid:
            self.rigid.reduce(x, r)
        self.project(r.array)

    @timed
    def gradient(self, x: PETSc.Vec, r: PETSc.Vec, terms: Sequence[Term] | None = None) -> None:
        """Assemble r = dE/dx [N] of ``terms``, by default of all. Collective.

        Constrained dofs and nodes of rigid parts keep their forces: the reactions.
        """
        u, p = self._unknowns.split(x)
        with self._unknowns.residual(r) as (r_u, r_p):
            for term in self.terms if terms is None else terms:
                term.add_residual(u, p, r_u, r_p)

    def gradient_at(self, x: PETSc.Vec, terms: Sequence[Term] | None = None) -> PETSc.Vec:
        """Return a new vector with the forces dE/dx [N] of `gradient`. Collective."""
        forces = self.x.duplicate()
        self.gradient(x, forces, terms)
        return forces

    @timed
    def jacobian(self, x: PETSc.Vec, filter: str, whole: bool = False) -> int:
        """Fill `P` with the Hessian d2E/dx2 [N/m], and set `asymmetric`. Collective.

        Parameters
        ----------
        x : PETSc.Vec
            The unknowns.
        filter : str
            The filter of negative eigenvalues: one of `fem_snh.choices.FILTERS`.
        whole : bool, optional
            Whether an exact Hessian contains the whole derivative of forces without an energy.
            Otherwise, and if filtered, it contains the symmetric part.

        Returns
        -------
        int
            The number of filtered quadrature points and cells on all ranks.
        """
        for term in self._asymmetric_terms:
            term.symmetric = not whole
        u, p = self.split(x)
        if self.rigid or self._rank_one:
            force = self.gradient_at(x)
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
        self.asymmetric = may_be and not is_symmetric(self.P)
        return int(self.comm.allreduce(filtered))

    def reactions(self, x: PETSc.Vec) -> dict[str, list[float]]:
        """Return the reaction force (3,) [N] of each group by name. Collective.

        It is the force of the group's conditions on the body: see `Reactions.sums`.
        """
        return self.reaction_sums(x).get("reactions", {})

    @property
    def reaction_notes(self) -> list[str]:
        """Notes on groups whose reaction includes or lacks forces of other groups' conditions."""
        return self._reactions.notes if self._reactions else []

    def reaction_sums(self, x: PETSc.Vec) -> dict[str, dict[str, list[float]]]:
        """Return the forces and moments of `Reactions.sums` at ``x``; {} without. Collective."""
        if self._reactions is None:
            return {}
        return self._reactions.sums(x.array_r, self.gradient_at(x).array_r)

    def rigid_states(self, x: PETSc.Vec) -> dict[str, dict[str, list[float]]]:
        """Return `RigidParts.states`: poses, forces and moments by part. Collective."""
        if self.rigid is None:
            return {}
        return self.rigid.states(x, self.gradient_at(x))

    def cell_fields(self, x: PETSc.Vec) -> dict[str, Array]:
        """Return fields with one value for each cell that this rank owns, (cells,). Collective.

        Reference and deformed volume ("volume", "deformed_volume") [m^3], smallest J ("min_J"),
        "energy" [J], and smallest eigenvalue of d2psi/dF2 ("min_eigenvalue") [Pa]. In cells without
        a material, whose energy is a UFL term, "energy" is 0 and "min_eigenvalue" -inf, as they are
        unknown; in rigid cells both are 0.
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
        """The own cells without a material, (n,) int, and loops over these cells. Collective.

        The loops, of an arbitrary material, give volumes and J; in plane stress the area and J of
        the plane, as the thickness depends on the energy. None if all cells have a material.
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
        """Return the measures of the body at ``x`` that `body_measures` describes. Collective."""
        return body_measures(self.comm, self.cell_fields(x), self.nodal(x), self._parts)

    def nodal(self, x: PETSc.Vec) -> Array:
        """Return a read-only view of the displacement in ``x``, (owned nodes, components) [m]."""
        values: Array = x.array_r[: self.owned_displacements]
        return values.reshape(-1, self._unknowns.components)


def check_converged(reason: str, asked: str) -> None:
    """Raise BadInput, with ``asked`` in the message, unless ``reason`` is a converged one."""
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
        "volume" and "deformed_volume" [m^3] and "min_J" of the cells that this rank owns.
    u : (owned nodes, components) array
        Displacement [m].
    parts : mapping of arrays, optional
        Parts of the body by name: see `Problem`.

    Returns
    -------
    dict
        ``volume_ratio``, deformed over reference volume; ``min_J``, the smallest J at a quadrature
        point; ``min_cell_J``, the smallest mean of J over a cell; ``max_u``, the largest norm of a
        nodal displacement [m]; if there are parts, ``volumes``, the volume ratio of each by name.
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
