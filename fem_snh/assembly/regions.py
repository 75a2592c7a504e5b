"""The parts of a body: which cells are filled by which material."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value, check_number
from fem_snh.kernels.material import Material
from fem_snh.mesh.mesh import DIMENSIONS, Group, Mesh, cell_volumes
from fem_snh.tables.types import surface_name


class Region(NamedTuple):
    """A part of the body that one material fills.

    Attributes
    ----------
    material : Material
        The material; None for the body of a program whose energy is in UFL.
    cells : (n,) int32
        The region's cells among those that this rank owns, sorted.
    density : float or None
        Mass per reference volume [kg/m^3].
    fractions : (n,) array or None
        The part of each cell's volume that the body fills; None: all of it.
    """

    material: Material
    cells: Array
    density: float | None = None
    fractions: Array | None = None

    @property
    def label(self) -> str:
        """The region's name in messages: its material's name."""
        return self.material.name if self.material else "the body"

    def filled(self, value: float) -> float | Array:
        """Return ``value`` times the ``fractions``, (n,); without these, ``value`` itself."""
        return value if self.fractions is None else value * self.fractions


def density_of(region: Region, purpose: str) -> float:
    """Return a region's density [kg/m^3].

    Raises
    ------
    BadInput
        If the region has no density, which ``purpose`` needs, or one that is not positive.
    """
    if region.density is None:
        where = f"of {region.label} (in a program: 'densities')"
        accepted = f"expected a number > 0, for {purpose}"
        raise BadInput(f"missing key 'material.density' {where}: {accepted}")
    check_number("material.density", region.density, 0.0, exclusive=True)
    return region.density


class Filling(NamedTuple):
    """A material and the physical group that it fills.

    Attributes
    ----------
    material : Material
        The material.
    group : str, int, ufl.Measure or None
        A physical group or a measure of cells; None for all cells that no other material fills.
    density : float or None
        Mass per reference volume [kg/m^3].
    """

    material: Material
    group: Any = None
    density: float | None = None

    @property
    def key(self) -> str:
        """The key of the group in messages."""
        is_name = isinstance(self.group, str | int)
        return "material.group" if is_name else f"materials[{self.material.name}]"


def without_cells(comm: Any, regions: Sequence[Region], cells: Array) -> list[Region]:
    """Return regions without some of this rank's cells. Collective.

    Regions without cells on all ranks are left out.
    """
    found = []
    for region in regions:
        kept = ~np.isin(region.cells, cells)
        fractions = None if region.fractions is None else region.fractions[kept]
        if comm.allreduce(int(kept.sum())):
            found.append(region._replace(cells=region.cells[kept], fractions=fractions))
    return found


def cells_of_one_label(V: FunctionSpace, labels: Array) -> Array:
    """Return the owned cells whose nodes all have the same label >= 0.

    ``labels`` are (local nodes,) int.
    """
    cells = labels[_dolfinx.node_dofs(V)[: _dolfinx.num_owned(V.mesh)]]
    return np.flatnonzero((cells[:, 0] >= 0) & (cells == cells[:, :1]).all(axis=1))


def whole_body(
    domain: _dolfinx.Mesh, material: Material | None, density: float | None = None
) -> list[Region]:
    """Return one region with all owned cells of a mesh, as a list."""
    cells = np.arange(_dolfinx.num_owned(domain), dtype=np.int32)
    return [Region(cast(Material, material), cells, density)]


def regions_with(
    domain: _dolfinx.Mesh, regions: Sequence[Region], density: float | None
) -> Sequence[Region]:
    """Return regions with ``density`` [kg/m^3] for each region that has none.

    Without regions, the whole body is returned as one region without a material.
    """
    if not regions:
        return whole_body(domain, None, density)
    return [r if r.density is not None else r._replace(density=density) for r in regions]


def fill_regions(mesh: Mesh, fillings: Sequence[Filling]) -> list[Region]:
    """Return a region for each filling, in their order; [] without fillings. Collective.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    fillings : sequence of Filling
        The materials with their groups; at most one is without a group.

    Raises
    ------
    BadInput
        On every rank: an unknown group, a group of other entities than cells, groups that overlap,
        cells without a material, or a material without a group if no cells remain.
    """
    if not fillings:
        return []
    owner = np.full(_dolfinx.num_owned(mesh.domain), -1, dtype=np.int32)  # number of the filling
    for number, filling in enumerate(fillings):
        if filling.group is not None:
            cells = owned_cells(mesh, filling.key, filling.group)
            _check_overlap(mesh, fillings, owner[cells], filling)
            owner[cells] = number
    rest = [number for number, filling in enumerate(fillings) if filling.group is None]
    missing = mesh.domain.comm.allreduce(int((owner < 0).sum()))
    if missing and not rest:
        named = fillings[0].key == "material.group"
        accepted = "a material without a group, which fills the rest"
        raise BadInput(
            f"material: {missing} of {mesh.num_cells} cells are in none of the groups "
            f"{_listed(fillings)}: expected {accepted if named else 'one for each cell'}"
        )
    if rest and not missing:
        raise BadInput(
            f"material.group: the groups {_listed(fillings)} fill the whole body: expected no "
            "material without a group"
        )
    owner[owner < 0] = rest[0] if rest else -1
    found = []
    for number, filling in enumerate(fillings):
        cells = np.flatnonzero(owner == number).astype(np.int32)
        fractions = None if mesh.fractions is None else mesh.fractions[cells]
        found.append(Region(filling.material, cells, filling.density, fractions))
    return found


def _check_overlap(
    mesh: Mesh, fillings: Sequence[Filling], owners: Array, filling: Filling
) -> None:
    """Raise BadInput on every rank if a filling's cells are in earlier fillings. Collective.

    ``owners`` (n,) are the numbers of the earlier fillings of these cells, -1 for none.
    """
    counts = np.bincount(owners[owners >= 0], minlength=len(fillings))
    counts = mesh.domain.comm.allreduce(counts)
    if counts.any():
        other, shared = surface_name(fillings[int(counts.argmax())].group), int(counts.max())
        accepted = f"a group that shares no cell with '{other}'; they share {shared}"
        raise bad_value(filling.key, surface_name(filling.group), accepted)


def _listed(fillings: Sequence[Filling]) -> str:
    """Return the names of the fillings' groups as text."""
    return ", ".join(f"'{surface_name(f.group)}'" for f in fillings if f.group is not None)


def reference_modulus(
    domain: _dolfinx.Mesh, regions: Sequence[Region], revolved: bool = False
) -> float:
    """Return the Young's modulus by which forces and pressures of a body are scaled. Collective.

    With several materials this is the harmonic mean over the volume, the modulus of a stack of
    layers (Reuss 1929). A tolerance relative to this modulus is tight enough for the softest
    layers, however stiff the other layers are.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    regions : sequence of Region
        The materials.
    revolved : bool, optional
        Whether volumes are those of the mesh revolved about the axis x = 0.

    Returns
    -------
    float
        Modulus [Pa]; with one material its own, without materials 1.
    """
    moduli = [region.material.numbers.E for region in regions]
    if len(set(moduli)) <= 1:
        return moduli[0] if moduli else 1.0
    return 1 / volume_mean(domain, regions, [1 / modulus for modulus in moduli], revolved)


def volume_mean(
    domain: _dolfinx.Mesh,
    regions: Sequence[Region],
    values: Sequence[float],
    revolved: bool = False,
) -> float:
    """Return the volume mean of a quantity with one value in each region. Collective."""
    if len(set(values)) == 1:
        return values[0]
    volume = cell_volumes(domain, revolved)
    local = [(volume[region.cells] * region.filled(1.0)).sum() for region in regions]
    volumes = domain.comm.allreduce(np.array(local))
    return float(volumes @ np.array(values) / volumes.sum())


def cell_constant(domain: _dolfinx.Mesh, regions: Sequence[Region], values: Sequence[float]) -> Any:
    """Return the DG0 dolfinx Function with one value in each region, 0 outside of all regions.

    In cells that the body fills in part, the value is multiplied by the filled fraction.
    """
    constant = _dolfinx.function_space(domain, 0, family="DG")
    function = _dolfinx.function(constant, "coefficient")
    dofs = _dolfinx.node_dofs(constant)[:, 0]
    for region, value in zip(regions, values, strict=True):
        function.x.array[dofs[region.cells]] = region.filled(value)
    return function


def find_group(mesh: Mesh, key: str, given: Any) -> Group:
    """Return a physical group by name or number, or the entities of a measure. Collective.

    Parameters
    ----------
    mesh : Mesh
        The mesh; a dolfinx program's mesh has no physical groups.
    key : str
        The key of the group, for messages.
    given : str, int or ufl.Measure
        The group.

    Raises
    ------
    BadInput
        On every rank, for an object of another type, an unknown group, and a measure on another
        mesh or without entities.
    """
    if isinstance(given, str | int):
        if not mesh.groups:
            raise bad_value(key, given, "a measure ds(...): the mesh of a program has no groups")
        return mesh.group(given)
    domain, shown = mesh.domain, surface_name(given)
    if not _dolfinx.is_measure(given, facets=True):
        raise bad_value(key, shown, "a physical group, or a measure dx(...) or ds(...)")
    if given.ufl_domain() not in (None, domain.ufl_domain()):
        raise bad_value(key, "a measure on another mesh", "the mesh of the displacement")
    try:
        entities: Array = _dolfinx.measure_entities(given, domain)
    except ValueError as error:
        raise bad_value(key, shown, str(error)) from None
    of_cells = _dolfinx.is_measure(given)
    count = domain.comm.allreduce(len(entities))
    if count == 0:
        kind = "cells" if of_cells else "facets of the boundary"
        raise bad_value(key, shown, f"a measure of {kind}; none has this tag")
    return Group(shown, mesh.dim if of_cells else mesh.dim - 1, 0, entities, count)


def boundary_facets(mesh: Mesh, key: str, given: Any) -> Array:
    """Return this rank's facets of a surface of the body, (n,): see `find_group`. Collective.

    Raises
    ------
    BadInput
        On every rank, also for a group that is not a surface, or is partly inside of the body: an
        integral over the boundary would omit the inner facets.
    """
    found = find_group(mesh, key, given)
    if found.dim != mesh.dim - 1:
        accepted = f"a {DIMENSIONS[mesh.dim - 1]}, not a {found.label}"
        raise bad_value(key, surface_name(given), accepted)
    exterior = _dolfinx.exterior_facets(mesh.domain)[0]
    outside = mesh.domain.comm.allreduce(int(np.isin(exterior, found.entities).sum()))
    if outside < found.count:
        inside = found.count - outside
        accepted = f"a surface of the body; {inside} of its {found.count} facets are inside of it"
        raise bad_value(key, given, accepted)
    return found.entities


def cells_or_facets(mesh: Mesh, key: str, given: Any) -> tuple[int, Array]:
    """Return dimension and entities of a group of cells or facets: see `find_group`. Collective.

    Raises
    ------
    BadInput
        On every rank, also for a group of edges or points.
    """
    found = find_group(mesh, key, given)
    if found.dim < mesh.dim - 1:
        accepted = f"a {DIMENSIONS[mesh.dim]} or a {DIMENSIONS[mesh.dim - 1]}, not a {found.label}"
        raise bad_value(key, given, accepted)
    return found.dim, found.entities


def owned_cells(mesh: Mesh, key: str, given: Any) -> Array:
    """Return this rank's own cells of a group of cells, (n,): see `find_group`. Collective.

    Raises
    ------
    BadInput
        On every rank, also for a group that is not of cells.
    """
    found = find_group(mesh, key, given)
    if found.dim != mesh.dim:
        accepted = f"a group of {DIMENSIONS[mesh.dim]}s, not a {found.label}"
        raise bad_value(key, surface_name(given), accepted)
    return found.entities[found.entities < _dolfinx.num_owned(mesh.domain)]
