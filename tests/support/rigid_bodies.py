"""Bodies with rigid parts: a bushing with a sleeve, and programs on a cube."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import tagged_measure, unit_cube, vector_space
from gmsh_files import write_msh

import fem_snh
from fem_snh.scenes import Hold, MaterialChoice, Rigid, Scene
from fem_snh.terms.rank_one import RankOneTerm

#: Inner radius of the sleeve, radii of the rubber, height; Young's modulus and Poisson's ratio.
BORE, INNER, OUTER, HEIGHT = 0.8, 1.0, 2.0, 0.3
E, NU = 1e6, 0.49
MU = E / (2 * (1 + NU))
#: A joint of the second part of `corner_program` to its first, askew.
HINGE_BETWEEN = {"kind": "hinge", "axis": (0.3, 1, 0.2), "through": (0.4, 0.5, 0.8), "to": "dx(2)"}


def bushing_mesh(comm: Any, folder: Any, around: int = 6, layers: int = 4, order: int = 1) -> Any:
    """Write the mesh of a bushing: volumes "sleeve", "rubber"; surfaces "outer", "ends"."""
    script = f"""
    Point(1) = {{{BORE}, 0, 0}};
    a[] = Extrude {{{INNER - BORE}, 0, 0}} {{ Point{{1}}; Layers{{1}}; Recombine; }};
    b[] = Extrude {{{OUTER - INNER}, 0, 0}} {{ Point{{a[0]}}; Layers{{{layers}}}; Recombine; }};
    sa[] = Extrude {{0, 0, {HEIGHT}}} {{ Line{{a[1]}}; Layers{{1}}; Recombine; }};
    sb[] = Extrude {{0, 0, {HEIGHT}}} {{ Line{{b[1]}}; Layers{{1}}; Recombine; }};
    x = sa[1]; y = sb[1]; sleeve[] = {{}}; rubber[] = {{}}; outer[] = {{}}; ends[] = {{}};
    bore[] = {{}};
    For k In {{1:4}}
      p[] = Extrude {{{{0, 0, 1}}, {{0, 0, 0}}, Pi/2}} {{
        Surface{{x}}; Layers{{{around}}}; Recombine; }};
      q[] = Extrude {{{{0, 0, 1}}, {{0, 0, 0}}, Pi/2}} {{
        Surface{{y}}; Layers{{{around}}}; Recombine; }};
      sleeve[] += {{p[1]}}; rubber[] += {{q[1]}}; outer[] += {{q[3]}}; ends[] += {{q[2], q[4]}};
      bore[] += {{p[5]}};
      x = p[0]; y = q[0];
    EndFor
    Physical Volume("sleeve") = {{sleeve[]}};
    Physical Volume("rubber") = {{rubber[]}};
    Physical Surface("outer") = {{outer[]}};
    Physical Surface("ends") = {{ends[]}};
    Physical Surface("bore") = {{bore[]}};
    """
    return write_msh(comm, folder, script, order=order)


def bushing(path: Any, rigid: dict[str, Any], **keys: Any) -> Scene:
    """Return the scene of a bushing in plane strain whose outer face is fixed."""
    given = {
        "element": "Q1P0",
        "material": [MaterialChoice(name="stable_neo_hookean", E=E, nu=NU)],
        "hold": [Hold(group="outer"), Hold(group="ends", components=("z",))],
        "petsc": {"snes_scaled_tol": 1e-11},
    }
    return Scene(name="bushing", mesh=path, rigid=[Rigid(group="sleeve", **rigid)], **given | keys)


def _rigid(dx: Any, tag: int | None = None, **keys: Any) -> Any:
    return fem_snh.Rigid(group=None if tag is None else dx(tag), **keys)


def corner_program(
    comm: Any,
    parts: Any,
    cells: int = 4,
    body_force: Any = None,
    pressure: float = 0.0,
    **keys: Any,
) -> Any:
    """Return a cube with a fixed bottom and rigid parts, dx(2) and dx(3) at the upper corners.

    A pressure is on the side x = 1, with free edges.
    """
    domain = unit_cube(comm, cells)
    V = vector_space(domain)
    u = fem.Function(V)
    corners = [lambda x: x[0] > 0.49, lambda x: x[0] < 0.26]
    places = [lambda x, at=corner: at(x) & (x[2] > 0.49) for corner in corners]
    dx = tagged_measure("dx", domain, [lambda x: x[0] == x[0], *places])
    facets = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0))
    fixed = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets), V)
    m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.45)
    terms = [_rigid(dx, **part) for part in parts]
    if body_force is not None:
        terms.append(-ufl.inner(fem.Constant(domain, np.array(body_force)), u) * ufl.dx)
    if pressure:
        ds = tagged_measure("ds", domain, [lambda x: np.isclose(x[0], 1)])
        terms.append(fem_snh.Pressure(ds(1), pressure))
    return fem_snh.NonlinearProblem(u, {m: dx}, bcs=[fixed], terms=terms, **keys)


def wave(problem: Any, number: float, size: float) -> Any:
    """Return a step of a `Problem` without a symmetry."""
    d, components = problem.x.duplicate(), problem.V.dofmap.index_map_bs
    values = np.sin(number * problem.coordinates + number)[:, :components]
    d.array[: problem.owned_displacements] = values.ravel()
    d.array[problem.constrained_dofs] = 0.0
    d.scale(size)
    return d


def move_away(problem: Any) -> None:
    """Move a `Problem` away from rest, along a path of its parts."""
    end = problem.x.duplicate()
    problem.retraction(problem.x, wave(problem, 9.0, 0.05), 1.0, end)
    end.copy(problem.x)


def first_derivative(f: Any, at: float, h: float) -> Any:
    """Return a derivative by differences of fourth order."""
    return (8 * (f(at + h) - f(at - h)) - f(at + 2 * h) + f(at - 2 * h)) * (1 / (12 * h))


def check_derivatives(problem: Any) -> None:
    """Compare residual and Hessian with the energy along a path of rigid motions."""
    move_away(problem)
    x, end, f, Hd = (problem.x, *(problem.x.duplicate() for _ in range(3)))
    d = wave(problem, 5.0, 0.1)

    def energy(s: float) -> float:
        problem.retraction(x, d, s, end)
        return problem.energy(end)

    problem.residual(x, f)
    assert f.dot(d) == pytest.approx(first_derivative(energy, 0.0, 1e-3), rel=1e-7)
    problem.jacobian(x, "exact")
    problem.operator.mult(d, Hd)
    fluids = [term for term in problem.terms if isinstance(term, RankOneTerm)]

    def lagrangian(s: float) -> float:
        """Return the energy, with the multipliers of fluids: their energy is p^2/(2 k)."""
        found, u = energy(s), problem.split(end)[0]
        g = u.copy()
        pressures = [float(fluid.goal("", u)[0]) / fluid.rank_one(u, g) for fluid in fluids]
        return found + sum(f.imbalance * p for f, p in zip(fluids, pressures, strict=True))

    h = 1e-2
    inner, outer = lagrangian(h) + lagrangian(-h), lagrangian(2 * h) + lagrangian(-2 * h)
    curvature = (16 * inner - 30 * lagrangian(0.0) - outer) / (12 * h**2)
    assert d.dot(Hd) == pytest.approx(curvature, rel=1e-6)
    # The residual at the end of a path is the slope there, too.
    problem.retraction(x, d, 0.7, end)
    problem.residual(end, f)
    assert f.dot(d) == pytest.approx(first_derivative(energy, 0.7, 1e-3), rel=1e-7)
