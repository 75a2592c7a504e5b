"""The body that terms act on, for scenes and programs, and the UFL expressions of its loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import ufl
from ufl.algorithms import extract_coefficients
from ufl.constantvalue import ConstantValue
from ufl.core.multiindex import MultiIndex
from ufl.corealg.traversal import traverse_unique_terminals

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import (
    Region,
    boundary_facets,
    cell_constant,
    cells_or_facets,
    density_of,
    reference_modulus,
)
from fem_snh.errors import bad_value
from fem_snh.mesh.mesh import Mesh, volume
from fem_snh.tables.amplitudes import LOAD_ITSELF, Amplitudes
from fem_snh.tables.validation import is_expression

if TYPE_CHECKING:
    from fem_snh.assembly.nodal_mass import NodalMass
    from fem_snh.terms.term import Term


class MotionInTime(Protocol):
    """The interface of `fem_snh.steps.dynamics.dynamics.Dynamics` that features use."""

    mass: NodalMass
    terms: list[Term]
    integrator: Any


#: Returns the motion of a body, given displacement, regions, Dirichlet conditions and kinematics.
CreateMotion = Callable[[Any, Sequence[Region], Dirichlet, Kinematics], Any]


@dataclass(frozen=True)
class Body:
    """The body that terms act on: the data from which features create their terms.

    Attributes
    ----------
    u : dolfinx Function
        The displacement [m].
    mesh : Mesh
        The mesh, with its physical groups and the surface that a lattice carries.
    regions : sequence of Region
        The materials with their cells and densities.
    dirichlet : Dirichlet
        The constrained dofs and their values.
    amplitudes : Amplitudes
        The factors of loads and motions as functions of the load.
    motion : MotionInTime or None
        The motion in time; None for a quasi-static body.
    kinematics : Kinematics
        How the displacement becomes a deformation gradient. Integrals over a body of revolution
        are integrals over the whole turn.
    """

    u: Any
    mesh: Mesh
    regions: Sequence[Region]
    dirichlet: Dirichlet
    amplitudes: Amplitudes = LOAD_ITSELF
    motion: MotionInTime | None = None
    kinematics: Kinematics = SOLID

    @property
    def V(self) -> Any:
        """The displacement's function space."""
        return self.u.function_space

    @property
    def domain(self) -> Any:
        """The dolfinx mesh."""
        return self.V.mesh

    @cached_property
    def volume(self) -> float:
        """The reference volume of the mesh [m^3]. Collective."""
        return volume(self.domain, self.kinematics.revolved)

    @property
    def length(self) -> float:
        """The size of the body, V^(1/3) [m]; in a plane the square root of its area. Collective."""
        return self.volume ** (1 / self.kinematics.volume_dimension)

    @cached_property
    def modulus(self) -> float:
        """The reference Young's modulus [Pa]: see `reference_modulus`. Collective."""
        return reference_modulus(self.domain, self.regions, self.kinematics.revolved)

    def facets(self, key: str, surface: Any) -> Array:
        """Return this rank's facets of a surface of the body, (n,). Collective.

        Parameters
        ----------
        key : str
            The key that names the surface, for messages.
        surface : str, int or ufl.Measure
            A physical group, or a measure of a program.

        Raises
        ------
        BadInput
            On every rank, unless the surface is a part of the boundary: see `boundary_facets`.
        """
        return boundary_facets(self.mesh, key, surface)

    def entities(self, key: str, group: Any) -> tuple[int, Array]:
        """Return the dimension of a group of cells or facets, and its entities. Collective.

        The entities (n,) are this rank's. Unlike in `facets`, the facets may be inside of the body.
        """
        return cells_or_facets(self.mesh, key, group)

    def measure(self, key: str, surface: Any) -> Any:
        """Return the UFL measure of a surface: see `facets`. Collective.

        On a body of revolution it is times 2 pi r.
        """
        ds = self.surface(key, surface)
        return self._turned(ds(metadata=surface.metadata()) if hasattr(surface, "metadata") else ds)

    def surface(self, key: str, surface: Any) -> Any:
        """Return the UFL measure of a surface, without 2 pi r: see `facets`. Collective."""
        return _dolfinx.surface_measure(self.domain, self.facets(key, surface))

    @property
    def cells(self) -> Any:
        """The UFL measure of all cells, times 2 pi r on a body of revolution."""
        return self._turned(ufl.dx)

    def _turned(self, measure: Any) -> Any:
        return of_the_body(self.kinematics, self.domain, measure)

    def density(self, purpose: str) -> Any:
        """Return the mass per reference volume [kg/m^3], a dolfinx Function.

        Raises
        ------
        BadInput
            If a material has no density. The message names ``purpose``, for which it is needed.
        """
        densities = [density_of(region, purpose) for region in self.regions]
        return cell_constant(self.domain, self.regions, densities)

    def components(self, key: str, value: Any) -> Any:
        """Return the first components of a vector, as many as the displacement has, in a list.

        A UFL expression is returned as `expression` does.

        Raises
        ------
        BadInput
            If a component that the displacement lacks is not zero.
        """
        components = self.kinematics.components
        if is_expression(value):
            return self.expression(key, value)
        if any(value[components:]):
            accepted = f"{components} components and zero, in {self.kinematics.name}"
            raise bad_value(key, list(value), accepted)
        return list(value[:components])

    def expression(self, key: str, value: Any) -> Any:
        """Return a UFL expression after `check_expression`, or numbers as a dolfinx Constant.

        ``value`` is a scalar, or a vector with the components of the displacement.
        """
        if not is_expression(value):
            return self.constant(value)
        check_expression(key, value, self.u, self.kinematics.components)
        return value

    def constant(self, value: Any) -> Any:
        """Return a dolfinx Constant with the value, on the body's mesh."""
        return _dolfinx.constant(self.domain, value)


def of_the_body(kinematics: Kinematics, domain: _dolfinx.Mesh, measure: Any) -> Any:
    """Return the measure; for a body of revolution, 2 pi r times the measure."""
    if not kinematics.revolved:
        return measure
    return WeightedMeasure(2 * ufl.pi * _dolfinx.coordinates(domain)[0], measure)


def displacement_gradient(u: Any, kinematics: Kinematics) -> Any:
    """Return H = F - I of a displacement in UFL, (3, 3).

    In plane stress it is the H of plane strain, with H[2, 2] = 0.
    """
    H = ufl.grad(u)
    if kinematics.dim == 3:
        return H
    radius = _dolfinx.coordinates(u.function_space.mesh)[0]
    return ufl.as_matrix(kinematics.gradient(u, H, radius))


class WeightedMeasure:
    """A UFL measure times a coefficient: ``f * weighted`` is ``f * coefficient * measure``."""

    def __init__(self, coefficient: Any, measure: Any) -> None:
        self._coefficient, self._measure = coefficient, measure

    def __rmul__(self, integrand: Any) -> Any:
        return integrand * self._coefficient * self._measure


#: Terminals of a UFL expression that has the same value at all points.
_UNIFORM = (ufl.Constant, ConstantValue, MultiIndex)


def is_uniform(value: Any) -> bool:
    """Return whether a value is uniform in space: numbers, or an expression of Constants."""
    return not is_expression(value) or all(
        isinstance(part, _UNIFORM) for part in traverse_unique_terminals(value)
    )


def present(value: Any) -> Array:
    """Return the present numerical value of a uniform value, with the shape of its expression."""
    if not is_expression(value):
        return np.asarray(value, dtype=float)
    constants = [c for c in traverse_unique_terminals(value) if isinstance(c, ufl.Constant)]
    numbers = {c: np.asarray(c.value) for c in constants}  # type: ignore[attr-defined]  # dolfinx
    found = np.empty(value.ufl_shape)
    for index in np.ndindex(found.shape):
        found[index] = value((), numbers, index)
    return found


def check_expression(key: str, value: Any, u: Any, size: int = 1) -> None:
    """Raise BadInput for a UFL expression of a wrong shape, or that contains the displacement.

    Parameters
    ----------
    key : str
        The key that has the value, for messages.
    value : UFL expression
        The value: a scalar, or a vector of ``size`` components.
    u : dolfinx Function
        The displacement.
    size : int
        Number of components of a vector.
    """
    if value.ufl_shape not in ((), (size,)):
        raise bad_value(key, f"a vector of {value.ufl_shape[0]}", f"{size} components")
    if u in extract_coefficients(value):
        accepted = "no displacement in it: forces that depend on it are forms of 'terms'"
        raise bad_value(key, value, accepted)
