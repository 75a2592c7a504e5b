"""The elastic energy and its residual against forms of UFL, for each volume treatment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
import ufl
from bodies import cube, norm

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Region
from fem_snh.kernels.material import material
from fem_snh.kernels.ufl_forms import FUNCTIONS, energy_density
from fem_snh.materials.invariants import MEASURES
from fem_snh.materials.parameters import BOUNDS
from fem_snh.materials.volume_split import PRESSURE, split
from fem_snh.terms.elastic import Elastic

#: Relative difference of energies and of residuals.
BOUND = 1e-12
#: Unit of the pressure unknown [Pa/m].
SCALE = 2.0

#: Element, materials of as many regions, largest displacement of a node [cell sizes].
CASES = {
    "P1 of stretches": ("P1", [("hencky", 0.3), ("stable_neo_hookean", 0.3)], 0.05),
    "P2 inverted": ("P2", [("stable_neo_hookean", 0.45)], 0.5),
    "P2P0 in regions": ("P2P0", [("neo_hookean", 0.45), ("stable_neo_hookean", 0.49)], 0.05),
    "Q1P0": ("Q1P0", [("stable_neo_hookean", 0.499)], 0.3),
    "P2P1": ("P2P1", [("stable_neo_hookean", 0.4999)], 0.2),
    "Q2Q1": ("Q2Q1", [("stable_neo_hookean", 0.5)], 0.2),
}
ON_RANKS = ("P2P0 in regions", "P2P1")


def in_ufl(part: Any, symbol: Any, expression: Any, value: Any) -> Any:
    """An expression of a symbol and the constants of a split energy."""
    call = sympy.lambdify((symbol, *part.energy.constants), expression, modules=FUNCTIONS)
    return call(value, *part.energy.values)


def energies(element: Any, regions: list[Region], u: Any, p: Any) -> tuple[Any, Any]:
    """The energy, and a form whose derivatives are the residuals."""
    domain, F = u.function_space.mesh, ufl.variable(ufl.Identity(3) + ufl.grad(u))
    cells = [region.cells for region in regions]
    measures = _dolfinx.cell_measures(domain, cells, element.cell, element.quadrature)
    given = list(zip([region.material.expression for region in regions], measures, strict=True))
    if element.volume == "pointwise":
        return (sum(energy_density(energy, F) * dx for energy, dx in given),) * 2
    given = [(split(energy, BOUNDS[element.volume]), dx) for energy, dx in given]
    form = sum(energy_density(part.deviatoric, F) * dx for part, dx in given)
    if p is not None:
        p, J = SCALE * p, ufl.det(F)
        duals = [(in_ufl(part, PRESSURE, part.dual_curve[0], p), dx) for part, dx in given]
        return (form + sum((p * J - dual) * dx for dual, dx in duals),) * 2
    space = _dolfinx.function_space(domain, 0, family="DG")
    mean, q, sums = _dolfinx.function(space, "mean"), ufl.TestFunction(space), []
    for density in (ufl.det(F), 1.0):
        sums.append(_dolfinx.create_vector(space))
        total = sum(density * q * dx for dx in measures)
        _dolfinx.assemble_vector(sums[-1], _dolfinx.form(total))
    mean.x.array[: len(sums[0].array)] = sums[0].array / sums[1].array
    mean.x.scatter_forward()
    J = ufl.variable(mean)
    terms = [(in_ufl(part, MEASURES["J"], part.volume_curve[0], J), dx) for part, dx in given]
    slopes = sum(ufl.diff(U, J) * ufl.det(F) * dx for U, dx in terms)
    return form + sum(U * dx for U, dx in terms), form + slopes


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=[pytest.mark.mpi] if case in ON_RANKS else []) for case in CASES],
)
def test_energy_and_residual(comm, case):
    """On 2 x 2 x 2 bent cells, at random displacements and pressures."""
    name, chosen, size = CASES[case]
    element = ELEMENTS[name]
    domain = cube(comm, element.cell, 2, 0.05).domain
    spaces = [_dolfinx.function_space(domain, element.degree, (3,))]
    if element.volume == "pressure":
        spaces.append(_dolfinx.function_space(domain, element.pressure_degree))
    cells = np.arange(len(_dolfinx.node_dofs(spaces[0])), dtype=np.int32)
    regions = [
        Region(material(name, E=1.7, nu=nu), part)
        for (name, nu), part in zip(chosen, np.array_split(cells, len(chosen)), strict=True)
    ]
    kernels = Elastic(spaces[0], element, regions, *spaces[1:], pressure_scale=SCALE)
    numbers, functions = np.random.default_rng(comm.rank), []
    for space, bound in zip(spaces, (size / 2, 0.3), strict=False):
        functions.append(_dolfinx.function(space, "state"))
        x = functions[-1].x.array
        x[:] = numbers.uniform(-bound, bound, len(x))
        functions[-1].x.scatter_forward()
    u, p = (*functions, None)[:2]
    states = [_dolfinx.petsc_vec(f) for f in functions]
    energy, form = energies(element, regions, u, p)
    expected = _dolfinx.assemble_scalar(_dolfinx.form(energy))
    vectors = (*states, None)[:2]
    assert np.isfinite(expected)
    assert kernels.energy(*vectors) == pytest.approx(expected, rel=BOUND)
    found = [_dolfinx.create_vector(space) for space in spaces]
    kernels.add_residual(*vectors, *(*found, None)[:2])
    for r, f, space in zip(found, functions, spaces, strict=True):
        r.ghostUpdate(addv=True, mode=True)
        wanted = _dolfinx.create_vector(space)
        derivative = ufl.derivative(form, f, ufl.TestFunction(space))
        _dolfinx.assemble_vector(wanted, _dolfinx.form(derivative))
        assert norm(comm, r.array - wanted.array) <= BOUND * norm(comm, wanted.array)
