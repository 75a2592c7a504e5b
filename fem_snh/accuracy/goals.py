"""Goals: the scalars of a solution whose error is estimated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.accuracy.duals import Dual, Linearisation, dual_of_reaction
from fem_snh.accuracy.state_checks import largest_displacement
from fem_snh.assembly.unknowns import add_ghosts, set_to_zero, writable_values
from fem_snh.problem.probes import Probes
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import reaction, virtual_rotation, weighted
from fem_snh.problem.solids import solids_in_shapes
from fem_snh.terms.body import displacement_gradient, of_the_body
from fem_snh.terms.term import ForceTerm, Term

Array = npt.NDArray[Any]
AXES = ("x", "y", "z")
#: A force of contact is rounding below this part of the largest force on a node.
_NO_FORCE = 1e-8


class Goal(Protocol):
    """One or several scalars of a state, such as the components of a displacement."""

    @property
    def names(self) -> Sequence[str]:
        """The name of each scalar."""

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """Return a function that evaluates the scalars of the problem's state. Collective."""

    def unit(self, problem: Problem) -> float:
        """Return the size of the largest displacement or force; 0 for other goals. Collective."""

    def dual(self, at: Linearisation, number: int) -> Dual:
        """Return the dual of a scalar, whose error is -z . r to first order.

        r is the gradient of the lifted problem's energy at the run's solution, less that of the
        run's energy; both with the reactions. Collective.
        """


def names_of(goals: Sequence[Goal]) -> list[str]:
    """Return the names of all scalars of some goals."""
    return [name for goal in goals for name in goal.names]


def bind_all(goals: Sequence[Goal], problem: Problem) -> Callable[[], Array]:
    """Return the function that evaluates all scalars of some goals, (n,): see `Goal.bind`."""
    functions = [goal.bind(problem) for goal in goals]
    return lambda: np.array([value for function in functions for value in function()])


def vector_of(name: str) -> str:
    """Return the name of the vector of which a goal is a component, or the goal's own."""
    rest, _, last = name.rpartition(".")
    return rest if last in AXES else name


class _Point(NamedTuple):
    name: str
    point: Sequence[float]


class VectorGoal:
    """Components of a vector.

    Parameters
    ----------
    name : str
        The vector's name.
    components : sequence of int
        The components.

    Attributes
    ----------
    is_force : bool
        Whether it is a force [N].
    """

    is_force = False

    def __init__(self, name: str, components: Sequence[int]) -> None:
        self._components = list(components)
        self.names = [f"{name}.{AXES[i]}" for i in components]

    def components_of(self, vector: Sequence[float] | Array) -> list[float]:
        """Return the goal's components of a vector (3,)."""
        return [float(vector[i]) for i in self._components]


class PointGoal(VectorGoal):
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
        self._point = _Point(name, point)

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`. Raises BadInput on every rank for a point outside the body."""
        probes = Probes(problem.u, [self._point])

        def values() -> list[float]:
            problem.split(problem.x)
            (u,) = probes.values().values()
            return self.components_of(u)

        return values

    @property
    def point(self) -> Sequence[float]:
        """The reference coordinates [m]."""
        return self._point.point

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`."""
        return largest_displacement(problem)

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        probes, i = Probes(at.problem.u, [self._point]), self._components[number]
        weights = _dolfinx.create_vector(at.problem.V)
        set_to_zero(weights)
        for nodes, basis in probes.weights():
            nodal = writable_values(weights).reshape(-1, at.problem.kinematics.components)
            nodal[nodes, i] += basis
        add_ghosts(weights)
        return at.dual_of(weights)


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
        super().__init__(name, components)
        self._entries = entries
        self._about = None if about is None else np.array(about, dtype=float)
        self.is_force = about is None

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        weights, about = self._entries(problem), self._about

        def values() -> list[float]:
            force, moment = reaction(problem, weights, (0, 0, 0) if about is None else about)
            return self.components_of(force if about is None else moment)

        return values

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`."""
        arm = 1.0 if self._about is None else problem.length
        return arm * problem.largest_force(problem.x)

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
        e, turning = problem.x.duplicate(), None
        e.set(0.0)
        e.array[: shape[0] * shape[1]] = weighted(weights, virtual).ravel()
        if self._about is not None and problem.rigid and not kinematics.revolved:
            turning = _turning(problem, weights, np.eye(3)[i])
        return dual_of_reaction(at, e, turning)


def _turning(problem: Problem, weights: Array, axis: Array) -> PETSc.Vec:
    """Return the derivative of a moment by the positions of rigid parts' nodes: f x axis."""
    assert problem.rigid is not None
    forces, found = problem.x.duplicate(), problem.x.duplicate()
    problem.gradient(problem.x, forces)
    found.set(0.0)
    dofs = problem.rigid.dofs
    f = weighted(weights[problem.rigid.nodes], forces.array_r[dofs])
    found.array[dofs] = np.cross(problem.kinematics.padded(f), axis)[:, : dofs.shape[1]]
    return found


class MeanGoal(VectorGoal):
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

    def __init__(self, name: str, measure: Any, components: Sequence[int] = (0, 1, 2)) -> None:
        super().__init__(name, components)
        self._measure = measure

    @property
    def on_surface(self) -> bool:
        """Whether it is the mean over facets."""
        return str(self._measure.integral_type()) != "cell"

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        weights = self._weights(problem)

        def values() -> list[float]:
            u = problem.split(problem.x)[0]
            return [float(weight.dot(u)) for weight in weights]

        return values

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`."""
        return largest_displacement(problem)

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        return at.dual_of(self._weights(at.problem)[number])

    def _weights(self, problem: Problem) -> list[PETSc.Vec]:
        """Return the derivatives of the means by the displacement."""
        V = problem.V
        dx = of_the_body(problem.kinematics, problem.domain, self._measure)
        components = problem.kinematics.components
        one = _dolfinx.constant(V.mesh, 1.0)
        size = _dolfinx.assemble_scalar(_dolfinx.form(one * dx))
        direction = _dolfinx.constant(V.mesh, np.zeros(components))
        form = _dolfinx.form(ufl.inner(direction, ufl.TestFunction(V)) * dx)
        weights = []
        for i in self._components:
            direction.value[:] = np.eye(components)[i] / size
            vector = _dolfinx.create_vector(V)
            _dolfinx.assemble_vector(vector, form)
            weights.append(vector)
        return weights


class FunctionalGoal:
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

    def __init__(self, name: str, form: Any, u: Any) -> None:
        self._form, self._u, self.names = form, u, [name]

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        compiled = _dolfinx.form(ufl.replace(self._form, {self._u: problem.u}))

        def values() -> list[float]:
            problem.split(problem.x)
            return [_dolfinx.assemble_scalar(compiled)]

        return values

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`."""
        return 0.0

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        form = ufl.replace(self._form, {self._u: at.problem.u})
        return at.dual_of(derivative_of(at.problem, form))


def derivative_of(problem: Problem, form: Any, x: PETSc.Vec | None = None) -> PETSc.Vec:
    """Return the derivative of a form of rank 0 by the displacement, by default at the solution."""
    problem.split(problem.x if x is None else x)
    vector = _dolfinx.create_vector(problem.V)
    _dolfinx.assemble_vector(vector, _dolfinx.form(ufl.derivative(form, problem.u)))
    return vector


class CellsGoal:
    """A scalar of the body, or of cells of it.

    Parameters
    ----------
    name : str
        Its name.
    cells : (n,) int array, optional
        Owned cells; default: all.
    """

    def __init__(self, name: str, cells: Array | None = None) -> None:
        self.names, self._cells = [name], slice(None) if cells is None else cells

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`."""
        return 0.0


class VolumeGoal(CellsGoal):
    """The deformed over the reference volume. Parameters are those of `CellsGoal`."""

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        if not problem.kinematics.plane_stress and solids_in_shapes(problem):
            return self._by_displacement(problem)

        def values() -> list[float]:
            fields = problem.cell_fields(problem.x)
            sums = [fields[key][self._cells].sum() for key in ("deformed_volume", "volume")]
            deformed, rest = problem.comm.allreduce(np.array(sums))
            return [float(deformed / rest)]

        return values

    def _by_displacement(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """Return the function that evaluates it also in cells that are not assembled."""
        form, size = self._deformed(problem)
        compiled = _dolfinx.form(form)

        def values() -> list[float]:
            problem.split(problem.x)
            return [_dolfinx.assemble_scalar(compiled) / size]

        return values

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`. In plane stress, where J is no function of grad u alone: NaN."""
        problem = at.problem
        if problem.kinematics.plane_stress:
            return at.unknown()
        form, size = self._deformed(problem)
        derivative = derivative_of(problem, form)
        derivative.scale(1 / size)
        return at.dual_of(derivative)

    def _deformed(self, problem: Problem) -> tuple[Any, float]:
        """Return the form of the deformed volume, and the reference volume. Collective."""
        domain, element, kinematics = problem.domain, problem.element, problem.kinematics
        cells = np.arange(_dolfinx.num_owned(domain), dtype=np.int32)
        parts = [cells[self._cells], np.setdiff1d(cells, cells[self._cells])]
        measure = _dolfinx.cell_measures(domain, parts, element.cell, element.quadrature)[0]
        dx = of_the_body(kinematics, domain, measure)
        size = _dolfinx.assemble_scalar(_dolfinx.form(_dolfinx.constant(domain, 1.0) * dx))
        H = displacement_gradient(problem.u, kinematics)
        return ufl.det(ufl.Identity(3) + H) * dx, size


class TermGoal:
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
        self._name, self._components, shown = name, list(components) or [0], label or name
        self.names = [f"{shown}.{AXES[i]}" for i in components] or [shown]
        self.is_force = len(components) > 0

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        term = self._term(problem)

        def values() -> list[float]:
            found = term.goal(self._name, problem.split(problem.x)[0])
            return [float(found[i]) for i in self._components]

        return values

    def is_without_contact(self, problem: Problem) -> bool:
        """Return whether it is a force that is rounding, with all its components. Collective."""
        force = self._term(problem).goal(self._name, problem.split(problem.x)[0])
        return self.is_force and bool(np.abs(force).max() <= _NO_FORCE * self.unit(problem))

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`."""
        return problem.largest_force(problem.x) if self.is_force else 0.0

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        problem, derivative = at.problem, _dolfinx.create_vector(at.problem.V)
        set_to_zero(derivative)
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
        set_to_zero(forces)
        term.add_nodal_forces(self._name, problem.split(x)[0], forces)
        add_ghosts(forces)
        parts = forces.array.reshape(-1, problem.kinematics.components)
        parts[:, [i for i in range(parts.shape[1]) if i != self._components[number]]] = 0.0
        return forces

    def _term(self, problem: Problem) -> Term:
        """Return the problem's term with the result."""
        return next(term for term in problem.terms if self._name in term.goals)


class EnergyGoal:
    """The energy of all terms [J]."""

    def __init__(self, name: str = "energy") -> None:
        self.names = [name]

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        return lambda: [problem.energy(problem.x)]

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`."""
        return 0.0

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`: the energy's error is r . step / 2, of second order."""
        return Dual(None, at.step * -0.5)


class RigidGoal(VectorGoal):
    """Components of a motion of a rigid part, or of what holds it against the flesh.

    Parameters
    ----------
    part, kind : str
        The part's name, and "displacement" [m] of its point, "rotation" [rad], the rotation vector,
        "force" [N] or "moment" [N m] about the point.
    components : sequence of int, optional
        The components; default: all.
    label : str, optional
        What it is called; default: PART.KIND.
    """

    def __init__(
        self, part: str, kind: str, components: Sequence[int] = (0, 1, 2), label: str = ""
    ) -> None:
        super().__init__(label or f"{part}.{kind}", components)
        self._part, self._kind, self.is_force = part, kind, kind == "force"

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""

        def values() -> list[float]:
            return self.components_of(problem.rigid_states(problem.x)[self._part][self._kind])

        return values

    def unit(self, problem: Problem) -> float:
        """See `Goal.unit`. That of a rotation is the displacement over the body's size."""
        if self._kind == "displacement":
            return largest_displacement(problem)
        if self._kind == "rotation":
            return largest_displacement(problem) / problem.length
        arm = problem.length if self._kind == "moment" else 1.0
        return arm * problem.largest_force(problem.x)

    def dual(self, at: Linearisation, number: int) -> Dual:
        """See `Goal.dual`."""
        problem, rigid, x = at.problem, at.problem.rigid, at.problem.x
        assert rigid is not None
        number = self._components[number]
        if self._kind in ("displacement", "rotation"):
            return at.dual_of_all(rigid.derivative_of_pose(x, self._part, self._kind, number))
        turned = self._kind == "moment"
        e, turning = rigid.velocity(x, self._part, np.eye(6)[number + 3 * turned]), None
        if turned:  # the arms turn with the part
            forces = x.duplicate()
            problem.gradient(x, forces)
            turning = rigid.derivative_of_arms(x, self._part, forces, number)
        return dual_of_reaction(at, e, turning)


#: The weight around a point ends at so many radii, where it is 1e-8. Cells there have at most so
#: many radii, for which the largest quadrature degree integrates the weight to 1e-3.
REACH, MOST_RADII = 3.0, 6.0


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
