"""The problem of a user's dolfinx program: its displacement, measures, conditions and UFL terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import isfinite
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import (
    Condition,
    Dirichlet,
    NodePlane,
    ThinSupports,
    axis_nodes,
    contradiction,
    facets_plane,
)
from fem_snh.assembly.elements import (
    CELLS,
    ELEMENTS,
    MAX_QUADRATURE_DEGREE,
    Element,
    element,
    names_for,
)
from fem_snh.assembly.inclined_planes import InclinedPlanes
from fem_snh.assembly.kinematics import PLANE_CELLS, SOLID, Kinematics, find_kinematics
from fem_snh.assembly.regions import Region, check_partition
from fem_snh.assembly.unknowns import (
    create_unknowns,
    local_values,
    summed_over_ranks,
    update_ghosts,
)
from fem_snh.errors import bad_value, check_whole, in_words, unknown_name
from fem_snh.kernels.material import Material
from fem_snh.mesh.mesh_checks import check_geometry, check_half_plane
from fem_snh.problem.problem import Problem
from fem_snh.tables.amplitudes import Amplitudes
from fem_snh.tables.types import surface_name
from fem_snh.terms.body import Body, CreateMotion, MotionInTime, measure_facets, measure_parts
from fem_snh.terms.feature import Feature, create_terms, grouped
from fem_snh.terms.mean_volume import VolumeEnergy, volume_term
from fem_snh.terms.symmetry import Symmetry
from fem_snh.terms.term import Term
from fem_snh.terms.ufl_term import TERM, UFLTerm, check_form

Array = npt.NDArray[Any]

#: Strain of the central difference in `_curvature`: about the cube root of the rounding error.
_STRAIN = 1e-5
#: Values that differ by less than this part of the largest one, and parts of a normal, are equal.
_ROUNDING = 1e-9
#: UFL's symbols of the integrals that a term may have, and what they integrate over.
_SYMBOLS = {"cell": "dx", "exterior_facet": "ds"}
_ENTITIES = {"dx": "cells", "ds": "facets of the boundary"}
#: What a mapping of densities has.
DENSITIES = "{material: density > 0}"
#: Keys of a measure's metadata that name a quadrature rule, and the values of the default one.
RULE_KEYS = ("quadrature_rule", "quadrature_scheme")
DEFAULT_RULES = (None, "", "default")


class LoadFunction:
    """A function of the load that conditions and terms call, if it is set.

    It is an object without a reference to the program's problem: PETSc's SNES refers to the
    conditions, and Python's collector does not find a cycle that leads through PETSc.
    """

    def __init__(self) -> None:
        self.function: Callable[[float], None] | None = None

    def __call__(self, load: float) -> None:
        if self.function is not None:
            self.function(load)


class DolfinxConditions(Dirichlet):
    """Dirichlet conditions of dolfinx, and planes of symmetry. Collective.

    With the attributes of `fem_snh.assembly.boundary_conditions.Dirichlet`.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    bcs : sequence of dolfinx DirichletBC or Symmetry
        Conditions on V or on components of it; where they overlap, a later one overrides an
        earlier one, and any overrides symmetry. Their values are read whenever `set_values` is
        called.
    on_load : callable, optional
        ``on_load(load)`` sets these values for a load parameter.
    kinematics : Kinematics, optional
        On a body of revolution the radial and rotational displacements are zero on the axis.

    Attributes
    ----------
    given : list of dolfinx DirichletBC or Symmetry
        All conditions.
    bcs : list of dolfinx DirichletBC
        The conditions of dolfinx.
    symmetry : dict of str to (n,) array
        This rank's facets in each plane of symmetry, by the condition's label.
    start : (n,) or None
        The values of `dofs` at load 0, from which they go to the present ones at load 1, in
        proportion to the load; None: the present ones at every load.

    Raises
    ------
    BadInput
        For a condition on another space.
    """

    def __init__(
        self,
        V: Any,
        bcs: Sequence[Any],
        on_load: Callable[[float], None] | None = None,
        kinematics: Kinematics = SOLID,
    ) -> None:
        self.given = list(bcs)
        self.bcs = [bc for bc in bcs if not isinstance(bc, Symmetry)]
        self._on_load, self.depends_on_load = on_load, on_load is not None
        self.by_hand = bool(self.bcs) and on_load is None
        mask = _dolfinx.create_vector(V)
        self._V, self._dofs, self._size = V, list[Array](), mask.getLocalSize()
        sizes = []
        components = kinematics.components
        numbers = [i for i, bc in enumerate(bcs) if not isinstance(bc, Symmetry)]
        self._labels, conditions = [f"bcs[{i}]" for i in numbers], list[Condition]()
        for number, bc in zip(numbers, self.bcs, strict=True):
            if not hasattr(bc, "dof_indices"):
                raise bad_value(
                    f"bcs[{number}]", bc, "a condition made by dolfinx.fem.dirichletbc, or Symmetry"
                )
            if not _dolfinx.bc_space_is_within(bc, V):
                accepted = "a condition on the displacement's function space or a component of it"
                raise bad_value(f"bcs[{number}]", "a condition on another space", accepted)
            dofs = _dolfinx.bc_dofs(bc)
            # Not all ghosts of constrained nodes need be in a condition.
            owned = dofs[dofs < mask.getLocalSize()]
            mask.array[owned] = 1.0
            self._dofs.append(owned)
            conditions.append(_condition_on(V, f"bcs[{number}]", owned, components))
            sizes.append(len(owned))
        totals = V.mesh.comm.allreduce(np.array(sizes, dtype=np.int64))
        for number, size in zip(numbers, totals, strict=True):
            if size == 0:
                accepted = "a condition on at least one node of the mesh"
                raise bad_value(f"bcs[{number}]", "a condition on no dof", accepted)
        on_axis = np.empty(0, np.int64)
        self._axis = axis_nodes(V) if kinematics.revolved else on_axis
        if kinematics.revolved:
            owned = mask.getLocalSize() // components
            nodes = self._axis[self._axis < owned]
            on_axis = np.concatenate([components * nodes + i for i in kinematics.off_axis])
            mask.array[on_axis] = 1.0
        update_ghosts(mask)
        self.constrained = local_values(mask).reshape(-1, components) > 0
        self.symmetry: dict[str, Array] = {}
        planes = self._symmetry_planes = dict[str, NodePlane]()
        for number, bc in enumerate(bcs):
            if isinstance(bc, Symmetry):
                label = f"bcs[{number}]"
                facets = measure_facets(V.mesh, f"{label}.group", bc.group)
                planes[label] = facets_plane(V, facets, f"{label}.group", surface_name(bc.group))
                self.symmetry[label] = facets
        self.conditions = [*conditions_of_planes(planes), *conditions]
        owned_nodes = mask.getLocalSize() // components
        self.planes = InclinedPlanes.of([*planes.values()], self.constrained, owned_nodes)
        self.dofs = np.flatnonzero(self.constrained[:owned_nodes])
        given = np.concatenate([np.empty(0, np.int64), *self._dofs])
        self._zero = np.union1d(np.setdiff1d(self.dofs, given), on_axis)
        self.start: Array | None = None
        self._on_axis = on_axis
        self._examined = False

    def thin_supports(self) -> ThinSupports | None:
        """Return what nodes constrain that are on no constrained facet; None without any.

        Collective.
        """
        if self._examined:
            return self.thin
        self._examined = True
        marked = self.constrained & ~covered_nodes(self._V, self.constrained, self._axis)
        for plane in self._symmetry_planes.values():
            marked[np.ix_(plane.nodes, abs(plane.normal) > _ROUNDING)] = False
        owned = np.flatnonzero(marked[: self._size // marked.shape[1]])
        thin = np.setdiff1d(owned, self._on_axis)
        of_bcs = np.array([np.isin(thin, dofs).any() for dofs in self._dofs], dtype=np.int32)
        found = self._V.mesh.comm.allreduce(of_bcs)
        names = [label for label, used in zip(self._labels, found, strict=True) if used]
        self.thin = ThinSupports(", ".join(names), thin) if names else None
        return self.thin

    def contradictions_of_values(self) -> list[str]:
        """Return a line for each pair of conditions that differ at common nodes. Collective.

        A condition that another one overrides as a whole is replaced by it.
        """
        comm, vector = self._V.mesh.comm, _dolfinx.create_vector(self._V)
        values, given = vector.array[: self._size], []
        taken = np.full(self._size, -1)
        for number, (bc, dofs) in enumerate(zip(self.bcs, self._dofs, strict=True)):
            _dolfinx.set_bcs(values, [bc])
            given.append(values[dofs].copy())
            taken[dofs] = number
        largest = max((abs(own).max(initial=0.0) for own in given), default=0.0)
        largest = comm.allreduce(largest, op=MPI.MAX)
        x, components = self._V.tabulate_dof_coordinates(), self.constrained.shape[1]
        differing: dict[tuple[int, int], tuple[set[int], set[tuple[float, ...]]]] = {}
        kept = np.zeros(len(self.bcs), dtype=np.int64)
        for number, (dofs, own) in enumerate(zip(self._dofs, given, strict=True)):
            kept[number] = (taken[dofs] == number).sum()
            different = dofs[abs(own - values[dofs]) > _ROUNDING * largest]
            for other in np.unique(taken[different]):
                at = different[taken[different] == other]
                points = {tuple(point) for point in x[at // components].tolist()}
                differing[number, int(other)] = set((at % components).tolist()), points
        kept = comm.allreduce(kept)
        lines, gathered = [], comm.allgather(differing)
        for first, other in sorted({pair for found in gathered for pair in found}):
            if not kept[first]:
                continue
            axes, places = (
                set[Any]().union(*(found[first, other][i] for found in gathered
                                   if (first, other) in found))
                for i in range(2)
            )  # fmt: skip
            names = [self._labels[i] for i in (first, other)]
            pair, at_least = in_words(names), min(places)
            lines.append(contradiction(pair, sorted(axes), len(places), at_least, names[1]))
        return lines

    def set_load(self, load: float) -> None:
        """Set the program's constants, functions and boundary values."""
        if self._on_load is not None:
            self._on_load(load)

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set what is constrained of ``x`` to its values at a load."""
        self.set_load(load)
        # Pressures may follow the displacement: ghosts of the conditions must not reach them.
        _dolfinx.set_bcs(x.array[: self._size], self.bcs)
        x.array[self._zero] = 0.0
        if self.start is not None:
            x.array[self.dofs] = (1 - load) * self.start + load * x.array_r[self.dofs]
        if self.planes:
            self.planes.prescribe(x.array)


def _condition_on(V: Any, label: str, owned_dofs: Array, components: int) -> Condition:
    """Return the condition on some of this rank's dofs, and the ghosts of others. Collective."""
    mask = _dolfinx.create_vector(V)
    mask.array[owned_dofs] = 1.0
    update_ghosts(mask)
    return condition_of_mask(label, local_values(mask).reshape(-1, components) > 0)


def condition_of_mask(label: str, mask: Array) -> Condition:
    """Return the condition on components of nodes, (local nodes, components) bool."""
    units = np.eye(mask.shape[1])
    return Condition(label, [(np.flatnonzero(m), n) for m, n in zip(mask.T, units, strict=True)])


def conditions_of_planes(planes: Mapping[str, NodePlane]) -> list[Condition]:
    """Return the conditions of planes of symmetry, by their labels."""
    return [Condition(label, [(plane.nodes, plane.normal)]) for label, plane in planes.items()]


def create_dolfinx_problem(
    u: Any,
    materials: Mapping[Material, Any],
    bcs: Sequence[Any] = (),
    terms: Sequence[Any] = (),
    element_name: str | None = None,
    densities: Mapping[Material, float] | None = None,
    volume: VolumeEnergy | None = None,
    *,
    on_load: Callable[[float], None] | None = None,
    motion: CreateMotion | None = None,
    duration: float | None = None,
    kinematics: str | None = None,
) -> Problem:
    """Return the problem of a displacement in a user's dolfinx program. Collective.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m].
    materials : mapping of Material to ufl.Measure
        The cells that each material fills, as ``dx`` or ``dx(1)``: at least one.
    bcs : sequence of dolfinx DirichletBC or Symmetry
        The Dirichlet conditions, and planes of symmetry.
    terms : sequence of ufl.Form, Feature or Term
        Energies and residuals: see `UFLTerm`; loads and contact; other terms.
    element_name : str, optional
        One of `ELEMENTS`, of the mesh's cell and the displacement's degree. Default: the element
        with the volume term at every quadrature point.
    densities : mapping of Material to float, optional
        Masses per reference volume [kg/m^3].
    volume : callable, optional
        A volume energy: see `volume_term`.
    on_load : callable, optional
        ``on_load(load)`` sets constants, functions and boundary values for a load parameter.
    motion : callable, optional
        Returns the motion in time of a body: `fem_snh.terms.body.CreateMotion`.
    duration : float, optional
        The time of load 1 [s], of a motion in time.
    kinematics : str, optional
        On a mesh of two dimensions, one of `fem_snh.assembly.kinematics.PLANAR`.

    Raises
    ------
    BadInput
        On every rank, for input that does not fit together.
    """
    chosen_kinematics = check_displacement(u, kinematics)
    check_materials(materials)
    bcs = _listed("bcs", bcs, "a list of conditions, [dolfinx.fem.dirichletbc(...), ...]")
    terms = _listed("terms", terms, f"a list of terms, each {TERM}")
    V = u.function_space
    check_geometry(V.mesh, "u.function_space.mesh")
    chosen = _element(u, element_name, materials, chosen_kinematics)
    regions = _regions(V.mesh, materials, _checked(densities, materials))
    conditions = DolfinxConditions(V, bcs, on_load, chosen_kinematics)
    moving = motion(u, regions, conditions, chosen_kinematics) if motion else None
    facets = partial(measure_facets, V.mesh)
    for number, term in enumerate(terms):
        if chosen_kinematics.dim == 2 and not getattr(term, "planar", True):
            accepted = "no such term, on a mesh of 2 dimensions"
            raise bad_value(f"terms[{number}]", type(term).__name__, accepted)
    amplitudes = Amplitudes((), duration)
    entities = partial(measure_parts, V.mesh)
    found = facets, entities, amplitudes, moving, None, chosen_kinematics
    body = Body(u, regions, conditions, *found)
    follows = conditions.depends_on_load
    made = [_term(term, f"terms[{i}]", u, follows) for i, term in enumerate(terms)]
    _check_features(made, chosen.name, moving)
    if not regions and chosen.pressure_degree:
        raise bad_value("element", chosen.name, "an element without a pressure, without materials")
    own = [volume_term(volume, u, chosen, follows)] if volume is not None else []
    created = [*create_terms(made, body), *own, *(moving.terms if moving else [])]
    if not regions and not any(term.has_hessian for term in created):
        raise bad_value("materials", materials, "a material, or a term that is not linear in u")
    unknowns = create_unknowns(u, chosen)
    problem = Problem(unknowns, chosen, regions, conditions, created, motion=moving)
    problem.given_terms, problem.given_volume = list(terms), volume
    if not regions:
        set_modulus(problem)
    return problem


class _ProgramKeys(SimpleNamespace):
    """The keys of a scene that a program has, for `Feature.check`; all others are None."""

    def __getattr__(self, key: str) -> None:
        return None


def _check_features(terms: Sequence[Any], element_name: str, motion: MotionInTime | None) -> None:
    """Raise BadInput if features contradict each other, the element or the motion in time."""
    obstacles = [term for term in terms if getattr(term, "key", "") == "obstacle"]
    time = SimpleNamespace(integrator=motion.integrator.name) if motion else None
    keys = _ProgramKeys(element=element_name, time=time, obstacle=obstacles)
    for kind, features in grouped(terms):
        if issubclass(kind, Feature):
            kind.check(features, keys)


def check_lists(problem: Problem, bcs: Sequence[Any] | None, terms: Sequence[Any] | None) -> None:
    """Raise BadInput if a list that a problem was made of has changed since then."""
    assert isinstance(problem.dirichlet, DolfinxConditions)
    made_of = {"bcs": (bcs, problem.dirichlet.given), "terms": (terms, problem.given_terms)}
    for key, (present, given) in made_of.items():
        if [*map(id, present or ())] != [*map(id, given)]:
            accepted = "the list that the problem was made of: make a new one for another"
            raise bad_value(key, f"a list of {len(present or ())} that has changed", accepted)


def _term(term: Any, name: str, u: Any, depends_on_load: bool) -> Any:
    """Return a feature or a term as it is, and the term of a form. Collective."""
    if isinstance(term, Feature | Term):
        return term
    if isinstance(term, Symmetry):
        raise bad_value(name, term, f"{TERM}; a Symmetry is one of 'bcs'")
    check_form(term, u, name)
    _check_integrals(term, name, u.function_space.mesh)
    return UFLTerm(term, u, name, depends_on_load)


def _checked(
    densities: Mapping[Material, float] | None, materials: Mapping[Material, Any]
) -> Mapping[Material, float]:
    """Return the densities, of None none; raise BadInput unless their keys are materials."""
    densities = {} if densities is None else densities
    if not isinstance(densities, Mapping):
        raise bad_value("densities", densities, DENSITIES)
    if unknown := [key for key in densities if key not in materials]:
        raise bad_value("densities", unknown[0], "only keys of 'materials'")
    return densities


def check_displacement(u: Any, name: str | None = None) -> Kinematics:
    """Return the kinematics of a displacement; ``name`` is that of one in two dimensions.

    Raises
    ------
    BadInput
        Unless ``u`` is a real displacement of degree 1 or 2 with the kinematics' components.
    """
    if not _dolfinx.is_function(u):
        raise bad_value("u", u, "a dolfinx Function, the displacement")
    if not _dolfinx.has_real_values(u):
        accepted = "float64 (a PETSc configured with real numbers in double precision)"
        raise bad_value("u.x.array.dtype", str(u.x.array.dtype), accepted)
    V, domain = u.function_space, u.function_space.mesh
    dimension, cell = _dolfinx.mesh_dimension(domain), _dolfinx.cell_name(domain)
    kinds = sorted(PLANE_CELLS)
    if not (dimension == (3, 3) and cell in kinds) and not (
        dimension == (2, 2) and cell in PLANE_CELLS.values()
    ):
        found = f"{cell} cells in {dimension[1]} dimensions"
        accepted = f"{' or '.join(kinds)} cells in 3, or "
        accepted += f"{' or '.join(PLANE_CELLS.values())} cells in 2"
        raise bad_value("u.function_space.mesh", found, accepted)
    kinematics = find_kinematics(name, dimension[0])
    if (
        tuple(u.ufl_shape) != (kinematics.components,)
        or not _dolfinx.is_lagrange(V)
        or _dolfinx.degree(V) not in (1, 2)
    ):
        accepted = "a continuous Lagrange space of degree 1 or 2 with "
        accepted += f"{kinematics.components} components"
        raise bad_value("u.function_space", str(V.ufl_element()), accepted)
    if kinematics.revolved:
        check_half_plane(domain, "u.function_space.mesh")
    return kinematics


def check_materials(materials: Any) -> None:
    """Raise BadInput unless ``materials`` maps materials to measures of cells."""
    accepted = "{fem_snh.material(...): a measure dx of cells}"
    if not isinstance(materials, Mapping):
        raise bad_value("materials", materials, accepted)
    for material, measure in materials.items():
        if not isinstance(material, Material) or not _dolfinx.is_measure(measure):
            raise bad_value("materials", {material: measure}, accepted)


def _listed(key: str, values: Any, accepted: str) -> Sequence[Any]:
    """Return a list or a tuple, of None an empty one; raise BadInput for anything else."""
    if values is None:
        return ()
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise bad_value(key, values, accepted)
    return values


def _check_integrals(form: Any, name: str, domain: Any) -> None:
    """Raise BadInput if an integral of a form is over no cell or facet of any rank. Collective."""
    for integral in form.integrals():
        symbol = _SYMBOLS[integral.integral_type()]
        try:
            counts = _dolfinx.count_entities(integral, domain)
        except ValueError as error:
            raise bad_value(name, f"{symbol}({integral.subdomain_id()})", str(error)) from None
        totals = domain.comm.allreduce(np.array([*counts.values()], dtype=np.int64))
        for number, total in zip(counts, totals, strict=True):
            if total == 0:
                accepted = f"an integral over {_ENTITIES[symbol]}; none has the tag {number}"
                raise bad_value(name, f"{symbol}({number})", accepted)


def _element(
    u: Any, name: str | None, materials: Mapping[Material, Any], kinematics: Kinematics
) -> Element:
    """The element by name or by the displacement's space, with the measures' quadrature degree."""
    V = u.function_space
    cell, degree = _dolfinx.cell_name(V.mesh), _dolfinx.degree(V)
    fitting = [other for other in names_for(cell) if ELEMENTS[other].degree == degree]
    if name is not None and name not in fitting:
        accepted = f"one of {', '.join(fitting)}, for a displacement of degree {degree} on "
        accepted += CELLS[cell]
        raise bad_value("element", name, accepted)
    degrees = {_quadrature_degree(m, measure) for m, measure in materials.items()}
    if len(degrees) > 1:
        found = ", ".join(sorted(str(d) for d in degrees))
        raise bad_value("materials", f"quadrature degrees {found}", "the same for all measures")
    return element(name or fitting[0], degrees.pop() if degrees else None, kinematics)


def _quadrature_degree(material: Material, measure: Any) -> Any:
    """Return the degree in a measure's metadata; raise BadInput for what would be ignored."""
    known = {"quadrature_degree", *RULE_KEYS}
    key = f"materials[{material.name}].metadata"
    for name, value in measure.metadata().items():
        if name not in known:
            raise unknown_name(f"{key} key", name, ("quadrature_degree",))
        if name in RULE_KEYS and value not in DEFAULT_RULES:
            accepted = "'default': materials have the quadrature rule of their element"
            raise bad_value(f"{key}['{name}']", value, accepted)
    degree = measure.metadata().get("quadrature_degree")
    degree = degree.item() if isinstance(degree, np.integer) else degree
    if degree is not None:
        check_whole("quadrature_degree", degree, 1, MAX_QUADRATURE_DEGREE)
    return degree


def _regions(
    domain: Any, materials: Mapping[Material, Any], densities: Mapping[Material, float]
) -> list[Region]:
    """The materials' cells; every cell has one material, unless there are none."""
    regions = []
    for material, measure in materials.items():
        if measure.ufl_domain() not in (None, domain.ufl_domain()):
            found = "a measure on another mesh"
            raise bad_value(f"materials[{material.name}]", found, "the mesh of the displacement")
        try:
            cells = _dolfinx.measure_entities(measure, domain)
        except ValueError as error:
            found = f"dx({measure.subdomain_id()})"
            raise bad_value(f"materials[{material.name}]", found, str(error)) from None
        if domain.comm.allreduce(len(cells)) == 0:
            found, accepted = f"dx({measure.subdomain_id()})", "a measure with at least one cell"
            raise bad_value(f"materials[{material.name}]", found, accepted)
        regions.append(Region(material, cells, densities.get(material)))
    if regions:
        check_partition(domain, regions)
    return regions


def set_modulus(problem: Problem) -> None:
    """Set the moduli of a problem without materials, from its terms at the start.

    That of forces is 3 times the shear modulus, E of an incompressible material: the least
    curvature of the energy in three uniform shears. Without resistance to shear, as of springs, it
    is the mean entry on the Hessian's diagonal over the nodes' distance, which has the same unit.

    Raises
    ------
    BadInput
        If the curvature is negative in the shears and in a dilation: of residuals with the other
        sign, which a solver of equations does not notice.
    """
    dim, components = problem.kinematics.dim, problem.kinematics.components
    gradients = np.zeros((dim + 1, components, 3))
    for i in range(dim):
        gradients[i, i, (i + 1) % dim] = 1.0  # u_i = g X_j
    gradients[dim] = np.eye(components, 3)
    *shears, dilation = [_curvature(problem, gradient) for gradient in gradients]
    if max(*shears, dilation) < 0:
        accepted = "energies, or residuals that are their derivatives: the stiffness is negative "
        accepted += "in shear and in dilation; multiply the forms by -1"
        raise bad_value("terms", "forms of the other sign", accepted)
    modulus = 3 * min(shears)
    if not (isfinite(modulus) and modulus > 0):
        problem.jacobian(problem.x, "clamp")
        distance = problem.length * (problem.dofs / components) ** (-1 / dim)
        modulus = (problem.matrix.constrained_diagonal or 1.0) / distance
    volume_dimension = problem.kinematics.volume_dimension
    problem.modulus = modulus
    problem.force_scale = modulus * problem.length ** (volume_dimension - 1)


def _curvature(problem: Problem, gradient: Array) -> float:
    """The second derivative of the energy in u = g G X by g, per volume [Pa]. Collective."""
    force, moved = problem.x.duplicate(), problem.x.duplicate()
    moved.set(0.0)
    moved.array[: problem.owned_displacements] = (problem.coordinates @ gradient.T).ravel()
    works = []
    for sign in (1, -1):
        state = problem.x.copy()
        state.axpy(sign * _STRAIN, moved)
        problem.gradient(state, force)
        works.append(float(force.dot(moved)))
    volume = problem.length**problem.kinematics.volume_dimension
    return (works[0] - works[1]) / (2 * _STRAIN * volume)


def covered_nodes(V: Any, constrained: Array, axis: Array) -> Array:
    """Return the nodes of facets whose nodes are all constrained, by component. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    constrained : (local nodes, components) bool
        What is constrained, ghosts included.
    axis : (n,) int
        Local nodes on the axis of revolution, whose facets have no area.

    Returns
    -------
    (local nodes, components) bool
    """
    cells = _dolfinx.node_dofs(V)
    off_axis = np.ones(len(constrained), dtype=bool)
    off_axis[axis] = False
    marks = np.zeros(constrained.shape)
    for local in _dolfinx.facet_nodes(V):
        nodes = cells[:, local]
        whole = constrained[nodes].all(axis=1) & off_axis[nodes].any(axis=1)[:, None]
        for component in range(constrained.shape[1]):
            marks[nodes[whole[:, component]], component] = 1.0
    return summed_over_ranks(V, marks) > 0
