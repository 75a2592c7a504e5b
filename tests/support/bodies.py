"""Small bodies for the tests of assembly, problems and solvers: meshes, fields, gathered arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from scipy.sparse import csr_matrix, vstack

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS, Element
from fem_snh.assembly.regions import Filling
from fem_snh.kernels.material import Material, material
from fem_snh.mesh import mesh
from fem_snh.problem.definition import Definition
from fem_snh.problem.problem import Problem
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Scene
from fem_snh.terms.feature import Feature

#: Elements whose problems UFL can express, and those whose displacement minimises an energy.
POINTWISE = [e.name for e in ELEMENTS.values() if e.volume == "pointwise"]
MINIMISING = [e.name for e in ELEMENTS.values() if e.volume != "pressure"]

#: A displacement by more than one cell in a step turns cells inside out. There neo_hookean has no
#: energy, so the first step fails.
PRESS = Scene(
    name="press",
    mesh=Geometry(source="cube"),
    cells=3,
    element="Q1",
    material=MaterialChoice(name="neo_hookean", E=1.0, nu=0.3),
    hold=[Hold(group="bottom")],
    move=[Move(group="top", translate=(0, 0, -0.5))],
    predictor="none",
)

FACES = ("left", "right", "bottom", "top", "front", "back")

#: The arguments of `fem_snh.material` besides E, by the name of a test's parameter. The barrier
#: gives stable_neo_hookean another kernel.
MATERIALS: dict[str, dict[str, Any]] = {
    "stable_neo_hookean": {"name": "stable_neo_hookean", "nu": 0.49},
    "stable_neo_hookean+barrier": {"name": "stable_neo_hookean", "nu": 0.3},
    "neo_hookean": {"name": "neo_hookean", "nu": 0.45},
    "fixed_corotational": {"name": "fixed_corotational", "nu": 0.45},
}

_MAIN = "stable_neo_hookean"
#: A test's parameter ``name``: each of MATERIALS, and one of them on several ranks as well.
every_energy = pytest.mark.parametrize(
    "name", [pytest.param(m, marks=[pytest.mark.mpi] if m == _MAIN else []) for m in MATERIALS]
)


def pairs(
    elements: Sequence[str], marks: Any = pytest.mark.mpi, materials: Iterable[str] = MATERIALS
) -> pytest.MarkDecorator:
    """Parametrise by every element, and by every material on one element of each volume treatment.

    Each pair is a kernel to compile. ``marks`` are those of the pairs of the first kind.
    """
    others = [m for m in materials if m != _MAIN]
    found = [pytest.param(e, _MAIN, marks=marks) for e in elements]
    found += [pytest.param(e, m) for e in ("P2", "Q1P0") if e in elements for m in others]
    return pytest.mark.parametrize("element, name", found)


@dataclass
class Condition:
    """A prescribed displacement, as `Problem` takes it."""

    group: str | int
    displacement: Callable[[np.ndarray, float], np.ndarray]
    components: tuple[str, ...] = ("x", "y", "z")


@dataclass
class Hold:
    """Zero displacement, as `Problem` takes it."""

    group: str | int
    components: tuple[str, ...] = ("x", "y", "z")


def cube(comm: MPI.Comm, cell: str, cells: int = 2, bend: float = 0.0, size: float = 1.0) -> Any:
    """Return [0, size]^3; ``bend`` moves inner nodes: the cells are neither equal nor affine."""
    made = mesh.generate(comm, "cube", cell, cells=cells)
    x = _dolfinx.geometry_x(made.domain)
    inside = 16 * (x * (1 - x)).prod(axis=1, keepdims=True)
    x += bend * inside * np.sin(x @ np.array([[1.0, 5, 2], [4, 2, 3], [3, 1, 7]]))
    x *= size
    return made


def one_cell(comm: MPI.Comm, cell: str) -> mesh.Mesh:
    """Return a mesh of one cell that is no unit cell."""
    corners = _dolfinx.reference_corners(cell)
    x = corners @ np.array([[1.1, 0.2, 0.1], [0, 0.9, -0.2], [0.1, 0, 1.2]]) + 0.1 * corners**2
    mine = slice(None) if comm.rank == 0 else slice(0)
    cells = np.arange(len(x))[None]
    domain = _dolfinx.create_mesh(comm, cells[mine], x[mine], cell, 1)
    return mesh.Mesh(domain, cell, (), 1)


def create_problem(
    body: mesh.Mesh,
    element: Element,
    filled: Material | Sequence[Filling],
    *,
    hold: Sequence[Any] = (),
    move: Sequence[Any] = (),
    symmetry: Sequence[Any] = (),
    features: Sequence[Any] = (),
    loads: Callable[..., Sequence[Any]] | None = None,
    **others: Any,
) -> Problem:
    """Return a problem whose conditions name groups; ``loads`` returns terms of its body."""
    fillings = [Filling(filled)] if isinstance(filled, Material) else filled
    terms = [*features, *([MadeTerms(make=loads)] if loads else [])]
    return Definition(body, element, fillings, [*symmetry, *hold, *move], terms, **others).problem()


class MadeTerms(Feature):
    """Terms that a test makes."""

    key, stateless, planar = "made", True, True
    make: Any

    def create_term(self, body: Any) -> Any:
        raise NotImplementedError

    @classmethod
    def create_terms(cls, features: Any, body: Any) -> Any:
        return features[0].make(body.mesh, body.u, body.regions, body.dirichlet)


def problem(
    body: mesh.Mesh,
    element: str,
    name: str = "stable_neo_hookean",
    E: float = 1.0,
    **conditions: Any,
) -> Problem:
    """Return a problem of an element and of one of MATERIALS."""
    return create_problem(body, ELEMENTS[element], material(E=E, **MATERIALS[name]), **conditions)


def set_values(p: Problem, function: Callable[[np.ndarray], np.ndarray], x: Any = None) -> Any:
    """Set x (default: the displacement) to ``function(coordinates)``, both (nodes, 3), and ghosts.

    Returns x.
    """
    x = p.x if x is None else x
    with x.localForm() as local:
        local.array[:] = function(p.V.tabulate_dof_coordinates()).ravel()
    return x


def wave(size: float, shift: float = 0.0) -> Callable[[np.ndarray], np.ndarray]:
    """Return a smooth field without symmetries, the same on any number of ranks."""
    k = np.array([[2.0, 5, 3], [3, 1, 4], [5, 3, 2]])
    return lambda X: size * np.sin(X @ k + np.array([0.3, 1.1, 2.5]) + shift)


def rows(A: Any) -> csr_matrix:
    """Return this rank's rows of a PETSc matrix."""
    indptr, indices, values = A.getValuesCSR()
    return csr_matrix((values, indices, indptr), shape=(A.getLocalSize()[0], A.getSize()[1]))


def dense(A: Any) -> np.ndarray:
    """Return a whole PETSc matrix on every rank. Collective."""
    return vstack(A.comm.tompi4py().allgather(rows(A))).toarray()


def norm(comm: MPI.Comm, local: np.ndarray) -> float:
    """Return the 2-norm of an array that is distributed over the ranks. Collective."""
    return float(np.sqrt(comm.allreduce(float((np.abs(local) ** 2).sum()))))


def constrained(p: Problem) -> np.ndarray:
    """Return which of this rank's dofs are constrained, (n,) bool."""
    mask = np.zeros(p.x.getLocalSize(), dtype=bool)
    mask[p.constrained_dofs] = True
    return mask


def free_components(p: Problem) -> np.ndarray:
    """Return 0 for constrained displacement components, else 1, (local nodes, 3). Collective."""
    mask = _dolfinx.create_vector(p.V)
    mask.set(1.0)
    mask.array[p.constrained_dofs] = 0.0
    mask.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
    with mask.localForm() as local:
        return local.array.reshape(-1, 3).copy()


def volumes(data):
    """The volumes of tetrahedra, from their corners."""
    corners = data.x[data.cells[:, :4]]
    return np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
