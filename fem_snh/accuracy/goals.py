"""Goals: the scalars of a solution whose error is estimated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.problem.probes import Probes
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]
AXES = ("x", "y", "z")


class Goal(Protocol):
    """One or several scalars of a state, such as the components of a displacement."""

    @property
    def names(self) -> Sequence[str]:
        """The name of each scalar."""

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """Return a function that evaluates the scalars of the problem's state. Collective."""


class _Point(NamedTuple):
    name: str
    point: Sequence[float]


class PointGoal:
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
        self._point, self._components = _Point(name, point), list(components)
        self.names = [f"{name}.{AXES[i]}" for i in components]

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`. Raises BadInput on every rank for a point outside the body."""
        probes = Probes(problem.u, [self._point])

        def values() -> list[float]:
            problem.split(problem.x)
            (u,) = probes.values().values()
            return [u[i] for i in self._components]

        return values


class ForceGoal:
    """Components of the reaction force [N] on nodes: the sum of dE/du over them.

    Parameters
    ----------
    name : str
        Name of the force.
    entries : callable
        Returns the (n, 3) bool mask of the owned dofs that are summed, given a problem.
    components : sequence of int, optional
        The components; default: all.
    """

    def __init__(
        self,
        name: str,
        entries: Callable[[Problem], Array],
        components: Sequence[int] = (0, 1, 2),
    ) -> None:
        self._entries, self._components = entries, list(components)
        self.names = [f"{name}.{AXES[i]}" for i in components]

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        mask, gradient = self._entries(problem), problem.x.duplicate()

        def values() -> list[float]:
            problem.gradient(problem.x, gradient)
            nodal = gradient.array_r[: mask.size].reshape(-1, 3)
            total = problem.comm.allreduce(np.where(mask, nodal, 0.0).sum(axis=0))
            return [float(total[i]) for i in self._components]

        return values


class MeanGoal:
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
        self._measure, self._components = measure, list(components)
        self.names = [f"{name}.{AXES[i]}" for i in components]

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        V, dx = problem.V, self._measure
        one = _dolfinx.constant(V.mesh, 1.0)
        size = _dolfinx.assemble_scalar(_dolfinx.form(one * dx))
        direction = _dolfinx.constant(V.mesh, np.zeros(3))
        form = _dolfinx.form(ufl.inner(direction, ufl.TestFunction(V)) * dx)
        weights = []
        for i in self._components:
            direction.value[:] = np.eye(3)[i]
            vector = _dolfinx.create_vector(V)
            _dolfinx.assemble_vector(vector, form)
            weights.append(vector)

        def values() -> list[float]:
            u = problem.split(problem.x)[0]
            return [float(weight.dot(u)) / size for weight in weights]

        return values


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


class VolumeGoal:
    """The deformed over the reference volume of the body, or of cells of it.

    Parameters
    ----------
    name : str
        Its name.
    cells : (n,) int array, optional
        Owned cells; default: all.
    """

    def __init__(self, name: str, cells: Array | None = None) -> None:
        self.names, self._cells = [name], slice(None) if cells is None else cells

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""

        def values() -> list[float]:
            fields = problem.cell_fields(problem.x)
            sums = [fields[key][self._cells].sum() for key in ("deformed_volume", "volume")]
            deformed, rest = problem.comm.allreduce(np.array(sums))
            return [float(deformed / rest)]

        return values


class EnergyGoal:
    """The energy of all terms [J]."""

    def __init__(self, name: str = "energy") -> None:
        self.names = [name]

    def bind(self, problem: Problem) -> Callable[[], Sequence[float]]:
        """See `Goal.bind`."""
        return lambda: [problem.energy(problem.x)]
