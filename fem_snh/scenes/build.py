"""Build the arguments of a program from a scene: mesh, unknowns, materials, conditions, terms."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fem_snh import _dolfinx
from fem_snh.assembly import elements
from fem_snh.assembly.kinematics import find_kinematics, kinematics_of
from fem_snh.assembly.unknowns import space_for
from fem_snh.errors import BadInput, on_every
from fem_snh.kernels.material import Material, material
from fem_snh.mesh import gmsh_input
from fem_snh.mesh.mesh import Mesh, generate, read
from fem_snh.scenes._bones import read_bones
from fem_snh.scenes._consistency import group_references
from fem_snh.scenes._material import MaterialChoice
from fem_snh.scenes._outputs import Geometry, Tetrahedra
from fem_snh.scenes.schema import Scene
from fem_snh.tables.shapes import shape_of

if TYPE_CHECKING:
    from fem_snh.mesh.gmsh_model import SizeField


@dataclass(frozen=True)
class Built:
    """The mesh and the arguments of a program that a scene states.

    Attributes
    ----------
    mesh : Mesh
        The mesh with its physical groups.
    statement : dict
        The arguments of `fem_snh.NonlinearProblem` that state the problem: ``u``, ``materials``,
        ``bcs``, ``terms``, ``element``, ...
    solver : dict
        The arguments that choose the solver: ``hessian``, ``globalization``, ...
    time : dict
        The additional arguments of `fem_snh.DynamicProblem`; empty for a quasi-static scene.
    """

    mesh: Mesh
    statement: dict[str, Any]
    solver: dict[str, Any]
    time: dict[str, Any]

    @property
    def arguments(self) -> dict[str, Any]:
        """All arguments of the program."""
        return self.statement | self.solver | self.time


def build(scene: Scene, comm: Any, mesh: Mesh | None = None) -> Built:
    """Return what a program needs to solve a scene's problem. Collective.

    Parameters
    ----------
    scene : Scene
        The scene.
    comm : MPI.Intracomm
        The communicator.
    mesh : Mesh, optional
        The mesh. Default: that of the scene, generated or read.

    Raises
    ------
    BadInput
        On every rank, for a scene that does not fit its mesh.
    """
    kinematics = kinematics_of(scene.kinematics)
    mesh = mesh or make_mesh(comm, scene)
    find_kinematics(scene.kinematics, mesh.dim)
    for where, key in group_references(scene):
        try:
            mesh.group(key)
        except BadInput as error:
            raise BadInput(f"{where} = {key!r}: {error}") from None
    element = elements.ELEMENTS[scene.element]
    V = space_for(mesh.domain, element, kinematics.components)
    bones: list[Any] = []
    if scene.bone:
        bones = on_every(comm, read_bones, scene)
    made = [(choice, make_material(choice)) for choice in scene.materials]
    statement: dict[str, Any] = {
        "u": _dolfinx.function(V, "displacement"),
        "materials": {material: choice.group for choice, material in made},
        "bcs": [*scene.symmetry, *scene.hold, *scene.move],
        "terms": scene.features,
        "element": scene.element,
        "densities": {m: choice.density for choice, m in made if choice.density is not None},
        "kinematics": scene.kinematics,
        "mesh": mesh,
        "bones": bones,
        "amplitudes": scene.amplitudes,
        "quadrature": scene.quadrature,
    }
    chosen = {
        "petsc_options": scene.petsc,
        "hessian": scene.hessian,
        "globalization": scene.globalization,
        "static_condensation": scene.static_condensation,
        "predictor": "none" if scene.predictor == "none" else "tangent",
    }
    time: dict[str, Any] = {}
    if scene.time:
        time = scene.time.model_dump(include={"integrator", "duration", "mass", "rho_infinity"})
        time["damping"] = scene.time.damping.mass, scene.time.damping.stiffness
    return Built(mesh, statement, chosen, time)


def make_material(choice: MaterialChoice, nu: float | None = None) -> Material:
    """Return the material of a table, with ``nu`` in place of the table's if it is given."""
    ratio = choice.nu if nu is None else nu
    return material(choice.name, choice.E, ratio, **choice.parameters)


def make_mesh(comm: Any, scene: Scene) -> Mesh:
    """Return the scene's mesh, generated or read. Collective."""
    if isinstance(scene.mesh, Path):
        return read(comm, scene.mesh, **_cells(scene))
    chosen = scene.mesh
    if isinstance(chosen, Geometry):
        parameters = _cells(scene) | chosen.parameters
        element = elements.element(scene.element, None, kinematics_of(scene.kinematics))
        return generate(comm, chosen.source, element.cell, **parameters)
    from fem_snh.mesh import lattice

    if isinstance(chosen, Tetrahedra):
        return lattice.create_tetrahedra(comm, partial(shape_of, chosen.surface), chosen.size)
    choices = chosen.cell, chosen.weighting, chosen.samples, chosen.skin
    return lattice.create(comm, partial(shape_of, chosen.lattice), *choices)


def mesh_with_sizes(scene: Scene, cell: str, sizes: SizeField) -> gmsh_input.MeshData:
    """Return a mesh of a scene's exact geometry with a size field. On rank 0 only."""
    if isinstance(scene.mesh, Path):
        return gmsh_input.mesh_shape(str(scene.mesh), sizes=sizes, **_cells(scene))
    assert isinstance(scene.mesh, Geometry)
    parameters = {**_cells(scene), **scene.mesh.parameters}
    source = gmsh_input.source_path(scene.mesh.source)
    return gmsh_input.generate(source, cell, parameters, sizes)


def _cells(scene: Scene) -> dict[str, int]:
    return {} if scene.cells is None else {"cells": scene.cells}
