r"""Goals: the scalars of a solution whose error is estimated.

Of stress they are means of von Mises' stress over cells, or around a point: with the deviator s of
the Cauchy stress

.. math:: Q = \int w \sqrt{3/2\, s : s} \,\mathrm{d}V \Big/ \int w \,\mathrm{d}V

over cells of the body at rest, with w = 1 or, around a point, :math:`w = \exp(-2 d^2/r^2)` at the
distance d (Becker & Rannacher 2001, sec. 3, on such regularised functionals). The pressure has no
part in s, so no volume term is needed, nor a pressure that is an unknown. The largest stress is no
goal: at a corner where it is singular each finer mesh has a larger one; nor is that at a point
alone, which no coarse mesh knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from math import ceil
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh._petsc import vector_like
from fem_snh.arrays import Array
from fem_snh.assembly.unknowns import add_ghosts, copy_to_function, writable_values
from fem_snh.errors import BadInput, bad_value
from fem_snh.kernels.material import Material
from fem_snh.problem.duals import Dual, Linearisation, dual_of_reaction
from fem_snh.problem.probes import Probes
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import reaction, virtual_rotation, weighted
from fem_snh.problem.state_notes import largest_displacement
from fem_snh.terms.body import displacement_gradient, of_the_body
from fem_snh.terms.term import ForceTerm, Term

AXES = ("x", "y", "z")
#: The weight around a point ends at so many radii, where it is 1e-8. Cells there have at most so
#: many radii, for which the largest quadrature degree integrates the weight to 1e-3.
REACH, MOST_RADII = 3.0, 6.0
#: Quadrature degree of stresses, the same in both elements: a state has one stress.
_DEGREE = 6
#: Stress below which its root is smooth, in E: at zero it has no derivative.
_ZERO = 1e-12
#: A force of contact is rounding below this part of the largest force on a node.
_NO_FORCE = 1e-8


class Goal:
    """One or several scalars of a state, such as the components of a displacement.

    Parameters
    ----------
    names : sequence of str
        The name of each scalar.
    kind : str
        What it is: "displacement", "rotation", "force", "moment", "energy", "frequency" or another
        functional.

    Attributes
    ----------
    names, kind
        The parameters.
    unasked : set of str
        Names of components that complete a vector and were not asked for: they are not shown.
    """

    def __init__(self, names: Sequence[str], kind: str = "functional") -> None:
        self.names, self.kind = list(names), kind
        self.unasked: set[str] = set()

    @property
    def asked(self) -> list[str]:
        """The names that were asked for."""
        return [name for name in self.names if name not in self.unasked]

    @property
    def is_force(self) -> bool:
        """Whether it is a force [N]."""
        return self.kind == "force"

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """Return a function that evaluates the scalars of the problem's state. Collective."""
        raise NotImplementedError

    def unit(self, problem: Problem) -> float:
        """Return the size of the largest displacement or force; 0 for other goals. Collective.

        It is multiplied by the body's size for moments, and divided by it for rotations.
        """
        if self.kind in ("displacement", "rotation"):
            size = largest_displacement(problem)
            return size / problem.length if self.kind == "rotation" else size
        if self.kind in ("force", "moment"):
            size = problem.largest_force(problem.x)
            return size * problem.length if self.kind == "moment" else size
        return 0.0

    def dual(self, at: Linearisation, number: int) -> Dual:
        """Return the dual of a scalar, whose error is -z . r to first order.

        r is the gradient of the lifted problem's energy at the run's solution, less that of the
        run's energy; both with the reactions. Collective.
        """
        raise NotImplementedError


def names_of(goals: Sequence[Goal]) -> list[str]:
    """Return the names of all scalars of some goals."""
    return [name for goal in goals for name in goal.names]


def is_as_far(size: float, farthest: float, start: float) -> bool:
    """Return whether a goal is as far from its value at the start as it was, or farther.

    Sizes are equal that differ by rounding: by a millionth of that and of the value at the start.
    """
    return size >= farthest - 1e-6 * (farthest + start)


def slices_of(goals: Sequence[Goal]) -> list[slice]:
    """Return the places of the components of each goal among all scalars."""
    ends = np.cumsum([len(goal.names) for goal in goals])
    return [slice(end - len(goal.names), end) for goal, end in zip(goals, ends, strict=True)]


def bind_all(goals: Sequence[Goal], problem: Problem) -> Callable[[], Array]:
    """Return the function that evaluates all scalars of some goals, (n,): see `Goal.bind`."""
    functions = [goal.bind(problem) for goal in goals]
    return lambda: np.array([value for function in functions for value in function()])


def vector_of(name: str) -> str:
    """Return the name of the vector of which a goal is a component, or the goal's own."""
    rest, _, last = name.rpartition(".")
    return rest if last in AXES else name


class VectorGoal(Goal):
    """Components of a vector.

    Parameters
    ----------
    name : str
        The vector's name.
    components : sequence of int
        The components.
    kind : str, optional
        See `Goal`.
    """

    def __init__(self, name: str, components: Sequence[int], kind: str = "displacement") -> None:
        super().__init__([f"{name}.{AXES[i]}" for i in components], kind)
        self._components = list(components)

    def components_of(self, vector: Sequence[float] | Array) -> list[float]:
        """Return the goal's components of a vector (3,)."""
        return [float(vector[i]) for i in self._components]


class WeightedGoal(VectorGoal):
    """Components of a weighted sum of nodal displacements [m]."""

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`. Raises BadInput on every rank for a point outside the body."""
        weights = self._weights(problem)

        def values() -> list[float]:
            u = problem.split(problem.x)[0]
            return [float(weight.dot(u)) for weight in weights]

        return values

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        return at.dual_of(self._weights(at.problem)[number])

    def _weights(self, problem: Problem) -> list[PETSc.Vec]:
        """Return the derivatives of the components by the displacement. Collective."""
        raise NotImplementedError


class PointGoal(WeightedGoal):
    """Components of the displacement [m] of a point of the reference body.

    Parameters
    ----------
    name : str
        The point's name.
    point : (3,) sequence of float
        Reference coordinates [m].
    components : sequence of int, optional
        The components; default: all.
    """

    def __init__(
        self, name: str, point: Sequence[float], components: Sequence[int] = (0, 1, 2)
    ) -> None:
        super().__init__(name, components)
        self.name, self.point = name, point

    def _weights(self, problem: Problem) -> list[PETSc.Vec]:
        probes, weights = Probes(problem.u, [self]), []
        for i in self._components:
            vector = _dolfinx.create_vector(problem.V)
            nodal = writable_values(vector).reshape(-1, problem.kinematics.components)
            for nodes, basis in probes.weights():
                nodal[nodes, i] += basis
            add_ghosts(vector)
            weights.append(vector)
        return weights


class MeanGoal(WeightedGoal):
    """Components of the mean displacement [m] over cells or facets of the reference body.

    Parameters
    ----------
    name : str
        Name of the mean.
    measure : ufl.Measure
        The cells or facets.
    components : sequence of int, optional
        The components; default: all.
    """

    def __init__(
        self, name: str, measure: ufl.Measure, components: Sequence[int] = (0, 1, 2)
    ) -> None:
        super().__init__(name, components)
        self._measure = measure

    def _weights(self, problem: Problem) -> list[PETSc.Vec]:
        V, components = problem.V, problem.kinematics.components
        dx = of_the_body(problem.kinematics, problem.domain, self._measure)
        size = _dolfinx.assemble_scalar(_dolfinx.form(_dolfinx.constant(V.mesh, 1.0) * dx))
        direction = _dolfinx.constant(V.mesh, np.zeros(components))
        form = _dolfinx.form(ufl.inner(direction, ufl.TestFunction(V)) * dx)
        weights = []
        for i in self._components:
            direction.value[:] = np.eye(components)[i] / size
            vector = _dolfinx.create_vector(V)
            _dolfinx.assemble_vector(vector, form)
            weights.append(vector)
        return weights


class ReactionGoal(VectorGoal):
    """Components of the reaction on nodes: the force [N], or its moment [N m] about a point.

    Parameters
    ----------
    name : str
        Name of the force or of the moment.
    entries : callable
        Returns which parts of dE/du at the owned nodes count, given a problem: a mask (n,
        components), or the weights of `counted_forces`.
    components : sequence of int, optional
        The components; default: all.
    about : (3,) sequence of float, optional
        The point of the moment [m]; without it the goal is the force.
    """

    def __init__(
        self,
        name: str,
        entries: Callable[[Problem], Array],
        components: Sequence[int] = (0, 1, 2),
        about: Sequence[float] | None = None,
    ) -> None:
        super().__init__(name, components, "force" if about is None else "moment")
        self._entries = entries
        self._about = None if about is None else np.array(about, dtype=float)

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        weights, about = self._entries(problem), self._about

        def values() -> list[float]:
            force, moment = reaction(problem, weights, (0, 0, 0) if about is None else about)
            return self.components_of(force if about is None else moment)

        return values

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        problem, weights = at.problem, self._entries(at.problem)
        kinematics, shape = problem.kinematics, weights.shape[:2]
        i = self._components[number]
        if self._about is None:
            virtual = np.broadcast_to(np.eye(3)[i, : shape[1]], shape)
        else:
            positions = problem.coordinates + kinematics.padded(problem.nodal(problem.x))
            virtual = virtual_rotation(kinematics, positions, i, self._about)
        e, turning = vector_like(problem.x, weighted(weights, virtual).ravel()), None
        if self._about is not None and problem.rigid and not kinematics.revolved:
            turning = _turning(problem, weights, np.eye(3)[i])
        return dual_of_reaction(at, e, turning)


def _turning(problem: Problem, weights: Array, axis: Array) -> PETSc.Vec:
    """Return the derivative of a moment by the positions of rigid parts' nodes: f x axis."""
    assert problem.rigid is not None
    found, dofs = vector_like(problem.x), problem.rigid.dofs
    f = weighted(weights[problem.rigid.nodes], problem.gradient_at(problem.x).array_r[dofs])
    found.array[dofs] = np.cross(problem.kinematics.padded(f), axis)[:, : dofs.shape[1]]
    return found


class FormGoal(Goal):
    """An integral over the body, which UFL differentiates.

    Attributes
    ----------
    halfway : bool
        Whether it is differentiated at the mean of the run's and the lifted solution.
    """

    halfway = False

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        form, factor = self._form(problem)
        compiled = _dolfinx.form(form)

        def values() -> list[float]:
            problem.split(problem.x)
            return [factor * _dolfinx.assemble_scalar(compiled)]

        return values

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        problem = at.problem
        form, factor = self._form(problem)
        problem.split(problem.x - 0.5 * at.step if self.halfway else problem.x)
        vector = _dolfinx.create_vector(problem.V)
        _dolfinx.assemble_vector(vector, _dolfinx.form(ufl.derivative(form, problem.u)))
        vector.scale(factor)
        return at.dual_of(vector)

    def _form(self, problem: Problem) -> tuple[ufl.Form, float]:
        """Return a form of rank 0 in the displacement, and the factor of its value. Collective."""
        raise NotImplementedError


class FunctionalGoal(FormGoal):
    """A UFL functional of the displacement.

    Parameters
    ----------
    name : str
        Its name.
    form : ufl.Form
        A form of rank 0.
    u : dolfinx Function
        The displacement in the form.
    """

    def __init__(self, name: str, form: ufl.Form, u: _dolfinx.Function) -> None:
        super().__init__([name])
        self._given, self._u = form, u

    def _form(self, problem: Problem) -> tuple[ufl.Form, float]:
        return ufl.replace(self._given, {self._u: problem.u}), 1.0


class CellsGoal(FormGoal):
    """A scalar of all cells or of some: a volume ratio, a mean of von Mises' stress.

    Parameters
    ----------
    name : str
        Its name.
    cells : (n,) int array, optional
        Owned cells; default: all.
    """

    def __init__(self, name: str, cells: Array | None = None) -> None:
        super().__init__([name])
        self._cells = slice(None) if cells is None else cells


class VolumeGoal(CellsGoal):
    """The deformed over the reference volume. Parameters are those of `CellsGoal`."""

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        if not problem.kinematics.plane_stress and len(problem.rigid_cells):
            return super().bind(problem)  # also in cells that are not assembled

        def values() -> list[float]:
            fields = problem.cell_fields(problem.x)
            sums = [fields[key][self._cells].sum() for key in ("deformed_volume", "volume")]
            deformed, rest = problem.comm.allreduce(np.array(sums))
            return [float(deformed / rest)]

        return values

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`. In plane stress, where J is no function of grad u alone: NaN."""
        return at.unknown() if at.problem.kinematics.plane_stress else super().dual(at, number)

    def _form(self, problem: Problem) -> tuple[ufl.Form, float]:
        domain, element, kinematics = problem.domain, problem.element, problem.kinematics
        cells = np.arange(_dolfinx.num_owned(domain), dtype=np.int32)
        parts = [cells[self._cells], np.setdiff1d(cells, cells[self._cells])]
        measure = _dolfinx.cell_measures(domain, parts, element.cell, element.quadrature)[0]
        dx = of_the_body(kinematics, domain, measure)
        size = _dolfinx.assemble_scalar(_dolfinx.form(_dolfinx.constant(domain, 1.0) * dx))
        H = displacement_gradient(problem.u, kinematics)
        return ufl.det(ufl.Identity(3) + H) * dx, 1 / size


class StressGoal(CellsGoal):
    """The mean of von Mises' stress [Pa]. Parameters are those of `CellsGoal`."""

    halfway = True  # a root is far from linear

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`. Raises BadInput in plane stress, and for a material without energy."""
        self._check(problem)
        return super().bind(problem)

    def _form(self, problem: Problem) -> tuple[ufl.Form, float]:
        whole, size = self._integrals(problem)
        return whole, problem.modulus / _dolfinx.assemble_scalar(_dolfinx.form(size))

    def _check(self, problem: Problem) -> None:
        """Raise BadInput where the stress is no function of the displacement that UFL derives."""
        key, name = "accuracy.goals", self.names[0]
        lattice = any(region.fractions is not None for region in problem.regions)
        if problem.kinematics.plane_stress or lattice or not problem.regions:
            accepted = "a body with a material, neither a lattice nor in plane stress"
            raise bad_value(key, name, accepted)
        for material in (region.material for region in problem.regions):
            if not material.has_energy:
                accepted = f"a material with an energy, not '{material.name}'"
                raise bad_value(key, name, accepted)

    def _weight(self, domain: _dolfinx.Mesh) -> tuple[Any, int]:
        """Return the weight of the mean in UFL, and the degree of its quadrature."""
        return _dolfinx.constant(domain, 1.0), _DEGREE

    def size_of_change(self, problem: Problem, start: PETSc.Vec) -> float:
        """Return the mean of the size of what the stress changed by from a state [Pa]. Collective.

        It has no sign: the change of the mean may be small by chance.
        """
        before = _dolfinx.function(problem.V, "before")
        copy_to_function(problem.split(start)[0], before)
        whole, size = map(_dolfinx.form, self._integrals(problem, before))
        problem.split(problem.x)
        change, volume = map(_dolfinx.assemble_scalar, (whole, size))
        return float(problem.modulus * change / volume)

    def _integrals(self, problem: Problem, other: Any = None) -> tuple[Any, Any]:
        """Return the forms of the integral of the stress over E, and of the weight.

        With another displacement ``other``, that of the size of their difference.
        """
        domain, kinematics = problem.domain, problem.kinematics
        weight, degree = self._weight(domain)
        every = np.arange(_dolfinx.num_owned(domain), dtype=np.int32)
        parts = [np.intersect1d(region.cells, every[self._cells]) for region in problem.regions]
        parts.append(np.setdiff1d(every, np.concatenate(parts)))
        measures = _dolfinx.cell_measures(domain, parts, problem.element.cell, degree)
        measures = [of_the_body(kinematics, domain, dx) for dx in measures[:-1]]
        materials = [region.material for region in problem.regions]

        def stresses_of(u: _dolfinx.Function) -> list[Any]:
            F = ufl.variable(ufl.Identity(3) + displacement_gradient(u, kinematics))
            return [_von_mises(material, F, problem.modulus) for material in materials]

        stresses = stresses_of(problem.u)
        if other is not None:
            pairs = zip(stresses, stresses_of(other), strict=True)
            stresses = [abs(stress - before) for stress, before in pairs]
        whole = sum(weight * sigma * dx for sigma, dx in zip(stresses, measures, strict=True))
        return whole, sum(weight * dx for dx in measures)


class PointStressGoal(StressGoal):
    """The mean of von Mises' stress [Pa] around a point of the body at rest.

    Parameters
    ----------
    name : str
        Its name.
    point : (3,) sequence of float
        Reference coordinates [m].
    radius : float
        The distance r [m] at which the weight is 0.14 of that at the point.
    domain : dolfinx Mesh
        The mesh of the body.

    Raises
    ------
    BadInput
        On every rank, for cells that are much larger than the radius, or far away. Collective.
    """

    def __init__(
        self, name: str, point: Sequence[float], radius: float, domain: _dolfinx.Mesh
    ) -> None:
        dim = domain.topology.dim
        place = np.asarray(point, dtype=float)[:dim]
        X = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)][..., :dim]
        sizes = sizes_near(X, place, radius)
        super().__init__(name, np.flatnonzero(sizes[: _dolfinx.num_owned(domain)]))
        size = domain.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
        if size == 0:
            shown = ", ".join(f"{x:g}" for x in place)
            raise bad_value("point", f"({shown})", f"a point within {REACH:g} radii of the body")
        if size > MOST_RADII * radius:
            accepted = (
                f"at least {size / MOST_RADII:.3g}, as cells have a size of {size:.3g} there, "
                "or a mesh with smaller ones there"
            )
            raise bad_value("radius", f"{radius:g}", accepted)
        self._place, self._radius = place, radius
        self._degree = _DEGREE + 4 * ceil(size / radius)

    def _weight(self, domain: _dolfinx.Mesh) -> tuple[Any, int]:
        """See `StressGoal`."""
        x = _dolfinx.coordinates(domain)
        squared = sum((x[i] - float(c)) ** 2 for i, c in enumerate(self._place))
        return ufl.exp(-2 * squared / self._radius**2), self._degree


def _von_mises(material: Material, F: Any, modulus: float) -> Any:
    """Return von Mises' stress over a modulus."""
    from fem_snh.kernels.ufl_forms import energy_density  # these import sympy
    from fem_snh.materials.parameters import BOUNDS
    from fem_snh.materials.volume_split import split

    energy = material.expression
    with suppress(BadInput):  # no volume term of its own: all of the energy
        energy = split(energy, BOUNDS["mean"]).deviatoric
    s = ufl.dev(ufl.diff(energy_density(energy, F), F) * F.T / (modulus * ufl.det(F)))
    return ufl.sqrt(1.5 * ufl.inner(s, s) + _ZERO**2)


def sizes_near(x: Array, point: Array, radius: float) -> Array:
    """Return the sizes of the cells that the weight around a point reaches; 0 for all others.

    Parameters
    ----------
    x : (cells, nodes, dim) array
        The nodes of the cells [m].
    point : (dim,) array
        The point [m].
    radius : float
        Its radius [m].
    """
    low, high = x.min(axis=1), x.max(axis=1)
    outside = np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0), axis=1)
    near = outside <= REACH * radius
    return np.where(near, (high - low).max(axis=1), 0.0)


class TermGoal(VectorGoal):
    """A result of a term: components of a force of contact [N], or a fluid's pressure [Pa].

    Parameters
    ----------
    name : str
        Its name among the ``goals`` of `fem_snh.terms.term.Term`.
    components : sequence of int, optional
        The components of a force; default: a scalar.
    label : str, optional
        What it is called; default: its name.
    """

    def __init__(self, name: str, components: Sequence[int] = (), label: str = "") -> None:
        super().__init__(label or name, components, "force" if components else "functional")
        self._name = name
        if not components:
            self.names, self._components = [label or name], [0]

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        term = self._term(problem)
        return lambda: self.components_of(term.goal(self._name, problem.split(problem.x)[0]))

    def is_without_contact(self, problem: Problem) -> bool:
        """Return whether it is a force that is rounding, with all its components. Collective."""
        force = self._term(problem).goal(self._name, problem.split(problem.x)[0])
        return self.is_force and bool(np.abs(force).max() <= _NO_FORCE * self.unit(problem))

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        problem, derivative = at.problem, _dolfinx.create_vector(at.problem.V)
        u = problem.split(problem.x)[0]
        component = self._components[number]
        self._term(problem).add_goal_derivative(self._name, component, u, derivative)
        add_ghosts(derivative)
        return at.dual_of(derivative)

    def nodal(self, problem: Problem, x: PETSc.Vec, number: int) -> PETSc.Vec | None:
        """Return the nodal forces of a component at the state ``x``, ghosted; None without any.

        In two elements they differ at the same state, by the quadrature of contact. Collective.
        """
        term = self._term(problem)
        if not isinstance(term, ForceTerm):
            return None
        forces = _dolfinx.create_vector(problem.V)
        term.add_nodal_forces(self._name, problem.split(x)[0], forces)
        add_ghosts(forces)
        parts = forces.array.reshape(-1, problem.kinematics.components)
        parts[:, [i for i in range(parts.shape[1]) if i != self._components[number]]] = 0.0
        return forces

    def _term(self, problem: Problem) -> Term:
        """Return the problem's term with the result."""
        return next(term for term in problem.terms if self._name in term.goals)


class EnergyGoal(Goal):
    """The energy of all terms [J]."""

    def __init__(self, name: str = "energy") -> None:
        super().__init__([name], "energy")

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        return lambda: [problem.energy(problem.x)]

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`: the energy's error is r . step / 2, of second order."""
        return Dual(None, at.step * -0.5)


class RigidGoal(VectorGoal):
    """Components of the motion of a rigid part, or of the force or moment that holds it.

    Parameters
    ----------
    part, kind : str
        The part's name, and "displacement" [m] of its reference point, "rotation" [rad], a vector,
        "force" [N] or "moment" [N m] about the point.
    components : sequence of int, optional
        The components; default: all.
    label : str, optional
        What it is called; default: PART.KIND.
    """

    def __init__(
        self, part: str, kind: str, components: Sequence[int] = (0, 1, 2), label: str = ""
    ) -> None:
        super().__init__(label or f"{part}.{kind}", components, kind)
        self._part = part

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        return lambda: self.components_of(problem.rigid_states(problem.x)[self._part][self.kind])

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        problem, rigid, x = at.problem, at.problem.rigid, at.problem.x
        assert rigid is not None
        number = self._components[number]
        if self.kind in ("displacement", "rotation"):
            return at.dual_of_all(rigid.derivative_of_pose(x, self._part, self.kind, number))
        turned = self.kind == "moment"
        e, turning = rigid.velocity(x, self._part, np.eye(6)[number + 3 * turned]), None
        if turned:  # the arms turn with the part
            turning = rigid.derivative_of_arms(x, self._part, problem.gradient_at(x), number)
        return dual_of_reaction(at, e, turning)
