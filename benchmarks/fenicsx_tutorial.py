"""Solve a scene as the hyperelasticity tutorial of FEniCSx does, for `benchmarks.stretch_times`.

dolfinx's NewtonSolver on UFL forms: exact tangent, full steps, MUMPS. A load step that fails is
halved; after one that converges the next is twice as large. A factorisation that runs out of memory
ends the run, as it needs as much for a smaller step.

    python -m benchmarks.fenicsx_tutorial FOLDER '{"scene": "stretch", "cells": 12, "nu": 0.49}'
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.nls.petsc import NewtonSolver

from benchmarks.assembly import JIT
from fem_snh import _dolfinx, scenes
from fem_snh._dolfinx.forms import _jit, _quiet
from fem_snh._petsc import default_options, mumps_out_of_memory
from fem_snh.assembly import elements
from fem_snh.files import replace_file
from fem_snh.kernels.material import material
from fem_snh.kernels.ufl_forms import energy_density
from fem_snh.mesh import mesh as meshes
from fem_snh.runs import make_mesh

#: Limits on the halvings of a step and on the Newton iterations of a step.
HALVINGS, MAX_IT = 6, 50
MUMPS = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    "ksp_error_if_not_converged": None,  # else Newton's method continues with NaN
}


def newton_solver(
    residual: Any, u: Any, conditions: Sequence[Any], jit_options: dict, petsc: dict[str, Any]
) -> Any:
    """Return a Newton solver without line search that stops on the residual's norm.

    The caller sets ``atol``, ``rtol`` and ``max_it``; ``petsc`` are options of the linear solver.
    ``solve(u)`` of the result returns (iterations, converged).
    """
    # Since 0.10 NonlinearProblem is an interface to SNES, and the old class has the longer name.
    kind = getattr(fem_petsc, "NewtonSolverNonlinearProblem", fem_petsc.NonlinearProblem)
    with _quiet():
        problem = kind(residual, u, list(conditions), **_jit(kind.__init__, jit_options))
        solver = NewtonSolver(u.function_space.mesh.comm, problem)
    solver.convergence_criterion = "residual"
    solver.error_on_nonconvergence = False
    solver.report = False
    ksp = solver.krylov_solver
    with default_options(ksp.getOptionsPrefix(), petsc):
        ksp.setFromOptions()
    return solver


def solve(
    scene: scenes.Scene, folder: Path | None = None, tolerance: float = 1e-7, goal: str = ""
) -> dict[str, Any]:
    """Solve a scene of dead loads and prescribed displacements. Collective.

    Parameters
    ----------
    folder : Path, optional
        Its ``run.json`` is written after every step.
    goal : str
        A goal of the scene, a component of a point, a force or a moment, whose value at the end is
        ``goal`` of the record.
    tolerance : float
        Tolerance of the residual, in units of E V^(2/3) as for `fem_snh.solver`.

    Returns
    -------
    dict
        The record; its residuals are in N.
    """
    comm = MPI.COMM_WORLD
    element = elements.element(scene.element, scene.quadrature)
    domain = make_mesh(comm, scene)
    (chosen,) = scene.materials
    energy = material(chosen.name, chosen.E, chosen.nu).expression
    V = _dolfinx.function_space(domain.domain, element.degree, (3,))
    u, v = _dolfinx.function(V, "displacement"), ufl.TestFunction(V)
    dx = ufl.Measure("dx", domain=domain.domain, metadata={"quadrature_degree": element.quadrature})
    parts: list[Any] = []
    conditions_of_u: list[Any] = []
    conditions: list[scenes.Hold | scenes.Move] = [*scene.hold, *scene.move]
    for condition in conditions:
        group = domain.group(condition.group)
        nodes = _dolfinx.locate_dofs(V, group.dim, group.entities)
        if len(condition.components) == 3:
            parts.append((condition, nodes, _dolfinx.function(V, "prescribed")))
            conditions_of_u.append(_dolfinx.prescribed(parts[-1][2], nodes))
            continue
        assert isinstance(condition, scenes.Hold)
        for axis in map("xyz".index, condition.components):
            dofs_of_axis = fem.locate_dofs_topological(V.sub(axis), group.dim, group.entities)
            conditions_of_u.append(fem.dirichletbc(PETSc.ScalarType(0), dofs_of_axis, V.sub(axis)))
    gradient = ufl.variable(ufl.Identity(3) + ufl.grad(u))
    F = ufl.derivative(energy_density(energy, gradient) * dx, u, v)
    load_factor = fem.Constant(domain.domain, PETSc.ScalarType(0))
    for traction in scene.traction:
        facets = domain.group(traction.group).entities
        vector = ufl.as_vector([float(x) for x in traction.vector])
        F -= load_factor * ufl.inner(vector, v) * _dolfinx.surface_measure(domain.domain, facets)

    def create_solver() -> Any:
        solver = newton_solver(F, u, conditions_of_u, JIT, MUMPS)
        solver.rtol, solver.max_it = 0.0, MAX_IT
        solver.atol = tolerance * energy.E * meshes.volume(domain.domain) ** (2 / 3)
        return solver

    solver = create_solver()
    points = V.tabulate_dof_coordinates()
    dofs = 3 * V.dofmap.index_map.size_global
    record: dict[str, Any] = {
        "scene": scene.name,
        "material": {"name": energy.name, "nu": energy.nu},
        "dofs": dofs,
        "ranks": comm.size,
        "steps": [],
        "converged": False,
    }
    load, size = 0.0, 1.0 / scene.steps
    while load < 1 and "status" not in record and size > 2.0**-HALVINGS / scene.steps * 0.75:
        to = min(load + size, 1.0) if load + size < 1 - 1e-12 else 1.0
        for condition, nodes, values in parts:
            if isinstance(condition, scenes.Move):  # held nodes stay at zero
                array = values.x.array.reshape(-1, 3)
                array[nodes] = condition.displacement(points[nodes], to)
        load_factor.value = to
        kept, start, working = u.x.array.copy(), perf_counter(), process_time()
        try:
            newton, good = solver.solve(u)
        except RuntimeError:  # a factorisation failed
            newton, good = 0, False
            pc = solver.krylov_solver.getPC()
            if mumps_out_of_memory(pc):
                code, detail = (pc.getFactorMatrix().getMumpsInfog(k) for k in (1, 2))
                record["status"] = f"MUMPS cannot factorise the matrix: INFOG = {code}, {detail}"
        residual = solver.b.norm()
        good = bool(good and np.isfinite(residual))
        if not good:
            u.x.array[:] = kept
        record["steps"].append(
            {"load": to, "converged": good, "newton": newton, "linear": newton,
             "residual": residual, "seconds": perf_counter() - start,
             "processor_seconds": process_time() - working}
        )  # fmt: skip
        load, size = (to, 2 * size) if good else (load, size / 2)
        if not good:  # a solver that has met NaN keeps it
            solver = create_solver()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        record["peak_memory_mb"] = comm.allreduce(peak)
        record["converged"] = load == 1.0
        if comm.rank == 0 and folder is not None:
            replace_file(folder / "run.json", json.dumps(record))
    if goal and record["converged"]:
        record["goal"] = _goal(scene, domain, V, u, F, goal)
    return record


def _goal(scene: scenes.Scene, domain: Any, V: Any, u: Any, F: Any, name: str) -> float:
    """Return a component of a probe at a node, or of a group's force or moment. On one rank."""
    kind, of, (axis,) = scenes.read_goal(name, scene)
    points, values = V.tabulate_dof_coordinates(), u.x.array.reshape(-1, 3)
    if kind == "point":
        point = next(probe.point for probe in scene.probe if probe.name == of)
        node = np.linalg.norm(points - point, axis=1).argmin()
        return float(values[node, axis])
    group = domain.group(of)
    nodes = _dolfinx.locate_dofs(V, group.dim, group.entities)
    forces = fem.petsc.assemble_vector(fem.form(F)).array.reshape(-1, 3)[nodes]
    if kind == "moment":
        (about,) = (r.about for r in scene.reactions if r.group == of)
        forces = np.cross(points[nodes] + values[nodes] - about, forces)
    return float(forces[:, axis].sum())


if __name__ == "__main__":
    given = json.loads(sys.argv[2])
    done = solve(scenes.load(given.pop("scene"), **given), Path(sys.argv[1]))
    sys.exit(0 if done["converged"] else 1)
