"""The body that terms act on, in a scene and in a program alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region, cell_constant, density_of, reference_modulus
from fem_snh.errors import bad_value
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.mesh.mesh import DIMENSIONS, Mesh, volume
from fem_snh.tables.amplitudes import LOAD_ITSELF, Amplitudes
from fem_snh.tables.types import surface_name
from fem_snh.tables.validation import is_expression
from fem_snh.terms.values import check_expression

if TYPE_CHECKING:
    from fem_snh.assembly.nodal_mass import NodalMass
    from fem_snh.terms.term import Term

Array = npt.NDArray[Any]
#: Returns dimension and this rank's entities of a group of cells or of facets, given as facets are.
Entities = Callable[[str, Any], tuple[int, Array]]
#: Returns this rank's facets of a surface, given the key that names it, for messages, and its name.
Facets = Callable[[str, Any], Array]


class MotionInTime(Protocol):
    """The motion of a body in time: `fem_snh.steps.dynamics.dynamics.Dynamics`."""

    mass: NodalMass
    terms: list[Term]
    integrator: Any


#: Returns the motion of a body, given displacement, regions, Dirichlet conditions and kinematics.
CreateMotion = Callable[[Any, Sequence[Region], Dirichlet, Kinematics], Any]


@dataclass(frozen=True)
class Body:
    """The body that terms act on: what a feature may ask for when it makes them.

    Attributes
    ----------
    u : dolfinx Function
        The displacement [m].
    regions : sequence of Region
        The materials with their cells and densities.
    dirichlet : Dirichlet
        The constrained dofs and their values.
    facets : callable
        ``facets(key, surface)`` returns this rank's facets (n,) of a surface, a physical group of
        a scene or a measure of a program; the key is that of messages. Collective. It raises
        BadInput on every rank, for anything else.
    entities : callable
        As ``facets``, also of groups of cells and of surfaces inside of the body: dimension and
        entities.
    amplitudes : Amplitudes
        The factors of loads and motions as functions of the load.
    motion : MotionInTime or None
        The motion in time; None of a quasi-static body.
    skin : Skin or None
        The surface that a lattice carries.
    kinematics : Kinematics
        How the displacement becomes a deformation gradient. On a body of revolution integrals are
        those of the whole turn.
    """

    u: Any
    regions: Sequence[Region]
    dirichlet: Dirichlet
    facets: Facets
    entities: Entities
    amplitudes: Amplitudes = LOAD_ITSELF
    motion: MotionInTime | None = None
    skin: Skin | None = None
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
        """The size of the body, V^(1/3) [m]; in a plane the root of its area. Collective."""
        return self.volume ** (1 / self.kinematics.volume_dimension)

    @cached_property
    def modulus(self) -> float:
        """The Young's modulus [Pa] by which forces are scaled. Collective."""
        return reference_modulus(self.domain, self.regions, self.kinematics.revolved)

    def measure(self, key: str, surface: Any) -> Any:
        """Return the UFL measure of a surface: see `facets`. Collective."""
        ds = self.surface(key, surface)
        return self._turned(ds(metadata=surface.metadata()) if hasattr(surface, "metadata") else ds)

    def surface(self, key: str, surface: Any) -> Any:
        """Return the UFL measure of a surface of the mesh itself, not revolved. Collective."""
        return _dolfinx.surface_measure(self.domain, self.facets(key, surface))

    @property
    def cells(self) -> Any:
        """The UFL measure of all cells."""
        return self._turned(ufl.dx)

    def _turned(self, measure: Any) -> Any:
        return of_the_body(self.kinematics, self.domain, measure)

    def density(self, purpose: str) -> Any:
        """Return the mass per reference volume [kg/m^3], a dolfinx Function.

        Raises
        ------
        BadInput
            If a material has no density, and the message says for which purpose one is needed.
        """
        densities = [density_of(region, purpose) for region in self.regions]
        return cell_constant(self.domain, self.regions, densities)

    def components(self, key: str, value: Any) -> Any:
        """Return a vector's components that are those of the displacement, or its expression.

        Raises
        ------
        BadInput
            If others are not zero.
        """
        components = self.kinematics.components
        if is_expression(value):
            return self.expression(key, value)
        if any(value[components:]):
            accepted = f"{components} components and zero, in {self.kinematics.name}"
            raise bad_value(key, list(value), accepted)
        return list(value[:components])

    def expression(self, key: str, value: Any) -> Any:
        """Return a scalar, or a vector with the displacement's components, in UFL.

        Numbers become a dolfinx Constant. It raises BadInput as `check_expression` does.
        """
        if not is_expression(value):
            return self.constant(value)
        check_expression(key, value, self.u, self.kinematics.components)
        return value

    def constant(self, value: Any) -> Any:
        """Return a dolfinx Constant."""
        return _dolfinx.constant(self.domain, value)


def of_the_body(kinematics: Kinematics, domain: Any, measure: Any) -> Any:
    """Return a measure of the mesh as that of the body: of a half plane with the factor 2 pi r."""
    if not kinematics.revolved:
        return measure
    return WeightedMeasure(2 * ufl.pi * _dolfinx.coordinates(domain)[0], measure)


def displacement_gradient(u: Any, kinematics: Kinematics) -> Any:
    """Return H = F - I in UFL, (3, 3), of a displacement; in plane stress that of plane strain."""
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


def group_facets(mesh: Mesh, key: str, group: Any) -> Array:
    """Return this rank's facets of a physical group that a scene's key names, (n,). Collective.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown, not a surface, or in part inside of the body:
        an integral over the boundary would leave that part out.
    """
    if not isinstance(group, str | int):
        raise bad_value(key, group, "a physical group of the scene's mesh, by name or number")
    found = mesh.group(group)
    if found.dim != mesh.dim - 1:
        raise bad_value(key, group, f"a {DIMENSIONS[mesh.dim - 1]}, not a {found.label}")
    exterior = _dolfinx.exterior_facets(mesh.domain)[0]
    outside = mesh.domain.comm.allreduce(int(np.isin(exterior, found.entities).sum()))
    if outside < found.count:
        inside = found.count - outside
        accepted = f"a surface of the body; {inside} of its {found.count} facets are inside of it"
        raise bad_value(key, group, accepted)
    return found.entities


def group_entities(mesh: Mesh, key: str, group: Any) -> tuple[int, Array]:
    """Return dimension and entities of a physical group of cells or facets. Collective.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown, or of another dimension.
    """
    if not isinstance(group, str | int):
        raise bad_value(key, group, "a physical group of the scene's mesh, by name or number")
    found = mesh.group(group)
    if found.dim < mesh.dim - 1:
        accepted = f"a {DIMENSIONS[mesh.dim]} or a {DIMENSIONS[mesh.dim - 1]}, not a {found.label}"
        raise bad_value(key, group, accepted)
    return found.dim, found.entities


def measure_parts(domain: Any, key: str, measure: Any) -> tuple[int, Array]:
    """Return dimension and entities of a program's measure of cells or facets. Collective.

    Raises
    ------
    BadInput
        On every rank, for what is no such measure on the mesh, or has no entities.
    """
    dim = domain.topology.dim
    if getattr(measure, "integral_type", str)() != "cell":
        return dim - 1, measure_facets(domain, key, measure)
    return dim, _measure_entities(domain, key, measure, "cells")


def measure_facets(domain: Any, key: str, measure: Any) -> Array:
    """Return this rank's facets of a program's measure, (n,). Collective.

    Raises
    ------
    BadInput
        On every rank, for what is no measure of exterior facets of the mesh, or has none.
    """
    if isinstance(measure, str | int):
        raise bad_value(key, measure, "a measure ds(...): the mesh of a program has no groups")
    return _measure_entities(domain, key, measure, "facets of the boundary")


def _measure_entities(domain: Any, key: str, measure: Any, kind: str) -> Array:
    """Return this rank's entities of a measure; raise BadInput if no rank has one. Collective."""
    if measure.ufl_domain() not in (None, domain.ufl_domain()):
        raise bad_value(key, "a measure on another mesh", "the mesh of the displacement")
    shown = surface_name(measure)
    try:
        entities: Array = _dolfinx.measure_entities(measure, domain)
    except ValueError as error:
        raise bad_value(key, shown, str(error)) from None
    if domain.comm.allreduce(len(entities)) == 0:
        raise bad_value(key, shown, f"a measure of {kind}; none has this tag")
    return entities
